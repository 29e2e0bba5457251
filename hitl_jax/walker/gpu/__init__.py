"""The walker's programs for NVIDIA's GPUs, and which version of them is used.

`one_thread`, the default, has run on a GPU: one thread works on a walker in the solver's rounds.
`four_threads` was written later. It has been compiled for a GPU and never run on one. What it does
otherwise is in the folder `four_threads`, and where `uses_four_threads` is asked. On CPUs both are
the same.
"""

from contextlib import AbstractContextManager

import jax

VERSIONS = ("one_thread", "four_threads")

_LEAST_CAPABILITY = 8.0
"""The kernels' text uses what came with it."""
_version = jax.make_user_context(VERSIONS[0])


def use(version: str) -> AbstractContextManager[None]:
    """Has programs for GPUs be of a version while its context lasts.

    `with gpu.use("four_threads"): ...` Like `jax.default_device` it holds in the thread that enters
    it. JAX keeps programs of both versions apart.

    Args:
        version: one of `VERSIONS`.

    Raises:
        ValueError: if it is none of them.
    """
    if version not in VERSIONS:
        raise ValueError(f"version {version!r}: must be one of {', '.join(VERSIONS)}")
    context: AbstractContextManager[None] = _version(version)
    return context


def uses_four_threads() -> bool:
    """Whether programs are for a GPU, and of the version that has not run on one."""
    return on_gpu() and _version.value == "four_threads"


def on_gpu() -> bool:
    """Whether JAX's default device is an NVIDIA GPU of 2020 (Ampere) or later.

    That is asked while a program is traced. What was traced for such a GPU runs on no other device:
    to have a walker on the CPU of a machine with one, trace it under `jax.default_device`.
    """
    chosen = default_device()
    if chosen.platform not in ("gpu", "cuda"):
        return False
    try:
        return float(chosen.compute_capability) >= _LEAST_CAPABILITY
    except ValueError:  # of another maker's, which has letters
        return False


def default_device() -> jax.Device:
    """The device that programs are traced for."""
    chosen = jax.config.jax_default_device
    if chosen is None or isinstance(chosen, str):
        chosen = jax.devices(chosen)[0]
    return chosen
