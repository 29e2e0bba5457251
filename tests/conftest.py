"""Settings that must come before JAX starts."""

import atexit
import os
import shutil
import tempfile

import pytest

from hitl_jax.xla.loop_flag import have_loops_in_one_kernel

# The devices that learn on a machine of two cores, whatever this one has.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

# Most of a test's time goes into compiling, much of it the same programs: they are shared between
# tests, in a folder that is empty at the start, so that nothing comes from an earlier session, or
# in one that whoever starts several sessions makes for them.
if "PYTEST_XDIST_WORKER" not in os.environ:
    _programs = os.environ.get("HITL_JAX_TEST_PROGRAMS")
    if not _programs:
        _programs = tempfile.mkdtemp(prefix="hitl-jax-tests-")
        atexit.register(shutil.rmtree, _programs, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _programs
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

# Compiled in haste: it takes two thirds of the time. In one piece: all cores have work already.
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
_flags, _pieces = os.environ.get("XLA_FLAGS", ""), "--xla_cpu_parallel_codegen_split_count"
if _pieces not in _flags:
    os.environ["XLA_FLAGS"] = f"{_flags} {_pieces}=1".strip()
have_loops_in_one_kernel()  # As in all commands.

# Files go to the workers one by one: what takes long must not be left for the end.
_LONGEST = (
    "test_many_machines",
    "test_seed_sweep",
    "test_interrupted_runs",
    "test_program_sizes",
    "test_brax",
    "test_hardcore",
    "test_walker",
    "test_rollout",
    "test_ablation",
    "test_live_session",
    "test_agent",
    "test_compiled_batch",
    "test_extending",
    "test_device_examiner",
    "test_margin",
    "test_kernel",
)


@pytest.fixture(scope="module")
def compiled_fully():
    """The programs that users run, here and in processes that are started.

    For tests of what depends on how numbers are rounded: of equality to the last bit.
    They stand last in their file, since all tests that follow there are compiled so too.
    """
    import jax

    from hitl_jax.training import compiled_batch

    def begin(hastily):
        compiled_batch.make_programs.cache_clear()
        jax.clear_caches()
        jax.config.update("jax_disable_most_optimizations", hastily)
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(hastily))

    begin(False)
    yield
    begin(True)


def pytest_collection_modifyitems(items):
    """Long files first, the others as they come."""
    places = {name: place for place, name in enumerate(_LONGEST)}
    items.sort(key=lambda item: places.get(item.path.stem, len(places)))
