"""How JAX uses this machine; called before the first array is made."""

import contextlib
import os
import pathlib

import jax

from hitl_jax.envs import num_cores


def use_all_cores() -> None:
    """Makes one CPU device a core, so that runs are learned side by side, and one more for acting.

    Small matrix products do not split over threads; whole runs do. Never fewer than two devices
    learn: XLA compiles a mesh of one otherwise, and a run's numbers would depend on the machine's
    cores. JAX_NUM_CPU_DEVICES goes before.
    """
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", max(2, num_cores()) + 1)


def keep_programs() -> None:
    """Keeps compiled programs in the user's cache folder, for the next start.

    JAX_COMPILATION_CACHE_DIR names another folder; JAX_ENABLE_COMPILATION_CACHE=false keeps none.
    Where there is no home, nothing is kept.
    """
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        with contextlib.suppress(RuntimeError):
            cache = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
            jax.config.update("jax_compilation_cache_dir", str(pathlib.Path(cache) / "hitl_jax"))
    # The default keeps only what took a second to compile.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
