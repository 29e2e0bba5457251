"""A GPU gets the version of programs that has run on one, unless the other is chosen."""

import re
import threading

import jax
import jax.numpy as jnp
import pytest

from hitl_jax import walker
from hitl_jax.envs import jax_pool
from hitl_jax.walker import gpu
from hitl_jax.walker.gpu import kernel

_LANES = 7
_RAN = """
    abs.f32 add.f32 add.s32 and.pred bra cvt.rmi.f32.f32 cvt.rni.f32.f32 cvta.to.global.u64
    div.rn.f32 div.s32 ld.global.f32 ld.global.s32 ld.global.u8 ld.param.u64 mad.lo.s32
    mad.wide.s32 max.NaN.f32 min.NaN.f32 min.s32 mov.f32 mov.pred mov.s32 mov.u32 mul.f32
    mul.lo.s32 neg.f32 neg.s32 not.pred or.pred rem.s32 ret selp.f32 selp.s32 setp.eq.f32
    setp.eq.s32 setp.ge.f32 setp.ge.s32 setp.gt.f32 setp.gt.s32 setp.le.f32 setp.le.s32 setp.lt.f32
    setp.lt.s32 setp.ne.s32 setp.neu.f32 sqrt.rn.f32 st.global.f32 st.global.s32 st.global.u8
    sub.f32 sub.s32 xor.pred
"""
"""PTX instructions of the kernels that have run on an H100."""
_NEVER_RAN = {"and.b32", "cvt.rzi.s32.f32", "shfl.sync.bfly.b32", "vote.sync.any.pred"}


@pytest.fixture(autouse=True)
def _clear_caches():
    """Clears JAX's caches: a program traced for a GPU is none for a CPU, and the reverse."""
    jax.clear_caches()
    yield
    jax.clear_caches()


def _traced(version, monkeypatch):
    """Instructions of all kernels of a tick for a GPU, and the tick's own operations."""
    texts, written = [], kernel.kernel_text

    def noted(*given):
        text, shapes = written(*given)
        texts.append(text)
        return text, shapes

    seeds = jnp.zeros(_LANES, jnp.uint32)
    command, action = jnp.zeros(_LANES, jnp.int32), jnp.zeros((_LANES, 4))
    with monkeypatch.context() as patch, gpu.use(version):
        patch.setattr(kernel, "kernel_text", noted)
        patch.setattr(gpu, "on_gpu", lambda: True)
        walkers = jax.eval_shape(lambda: jax_pool.new_walkers(seeds, False))
        closed = jax.make_jaxpr(jax_pool.tick.__wrapped__)(walkers, command, action, seeds)
    lines = re.findall(r"^(?:@!?%p\d+ )?([a-z][\w.]*)(?: .*)?;$", "\n".join(texts), re.MULTILINE)
    return set(lines), {eqn.primitive.name for eqn in closed.jaxpr.eqns}


def test_by_default_a_gpu_gets_instructions_that_have_run_on_one(monkeypatch):
    instructions, operations = _traced(gpu.VERSIONS[0], monkeypatch)
    assert instructions == set(_RAN.split())
    assert "cond" in operations
    instructions, operations = _traced("four_threads", monkeypatch)
    assert instructions - set(_RAN.split()) == _NEVER_RAN
    assert "cond" not in operations


def test_a_cpu_gets_the_same_program_for_both_versions():
    walkers = jax.eval_shape(
        jax.vmap(walker.new_walker), jax.random.split(jax.random.key(0), _LANES)
    )
    texts = set()
    for version in gpu.VERSIONS:
        with gpu.use(version):
            # A new function each time, which JAX has not traced before.
            step = jax.vmap(lambda *given: walker.step(*given))
            texts.add(str(jax.make_jaxpr(step)(walkers, jnp.zeros((_LANES, 4)))))
    assert len(texts) == 1


@pytest.mark.parametrize("version", ["", "three_threads", "One_thread", "one_thread ", None, 4])
def test_unknown_versions_are_refused(version):
    with pytest.raises(ValueError, match=r"^version .*: must be one of one_thread, four_threads$"):
        gpu.use(version)


def test_a_version_ends_with_its_context(monkeypatch):
    monkeypatch.setattr(gpu, "on_gpu", lambda: True)
    assert not gpu.uses_four_threads()
    with gpu.use("four_threads"):
        assert gpu.uses_four_threads()
        with gpu.use("one_thread"):
            assert not gpu.uses_four_threads()
        assert gpu.uses_four_threads()
    with pytest.raises(KeyError), gpu.use("four_threads"):
        raise KeyError
    assert not gpu.uses_four_threads()


def test_a_version_is_chosen_for_one_thread(monkeypatch):
    monkeypatch.setattr(gpu, "on_gpu", lambda: True)
    seen = []
    with gpu.use("four_threads"):
        other = threading.Thread(target=lambda: seen.append(gpu.uses_four_threads()))
        other.start()
        other.join()
    assert seen == [False]


def test_programs_of_both_versions_are_kept_apart(monkeypatch):
    monkeypatch.setattr(gpu, "on_gpu", lambda: True)
    traced = []

    @jax.jit
    def threads(number):
        traced.append(gpu.uses_four_threads())
        return number * (4 if gpu.uses_four_threads() else 1)

    for _ in range(2):
        for version, expected in zip(gpu.VERSIONS, (1, 4), strict=True):
            with gpu.use(version):
                assert threads(jnp.int32(1)) == expected
    assert traced == [False, True]
