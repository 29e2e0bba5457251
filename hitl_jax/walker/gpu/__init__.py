"""The walker's programs for NVIDIA GPUs, in two versions.

`one_thread`, the default, has run on a GPU: one thread solves one walker. `four_threads` compiles
for a GPU and has not run on one. Its differences are in the folder `four_threads`, and where
`uses_four_threads` is asked. On CPUs both versions are the same.
"""

from contextlib import AbstractContextManager

import jax

VERSIONS = ("one_thread", "four_threads")

_MIN_CAPABILITY = 8.0
"""Compute capability whose instructions the kernels use."""
_version = jax.make_user_context(VERSIONS[0])


def use(version: str) -> AbstractContextManager[None]:
    """Selects the version of programs for GPUs: `with gpu.use("four_threads"): ...`.

    Like `jax.default_device` it holds in the thread that enters it. JAX caches programs of the two
    versions separately.

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
    """Whether programs are for a GPU and of version `four_threads`."""
    return on_gpu() and _version.value == "four_threads"


def on_gpu() -> bool:
    """Whether JAX's default device is an NVIDIA GPU of 2020 (Ampere) or later.

    This is asked while a program is traced, and a program traced for a GPU runs on no other device.
    To run a walker on the CPU of a machine with a GPU, trace it under `jax.default_device`.
    """
    chosen = default_device()
    if chosen.platform not in ("gpu", "cuda"):
        return False
    try:
        return float(chosen.compute_capability) >= _MIN_CAPABILITY
    except ValueError:  # Another maker's GPU: its capability has letters.
        return False


def default_device() -> jax.Device:
    """The device for which programs are traced."""
    chosen = jax.config.jax_default_device
    if chosen is None or isinstance(chosen, str):
        chosen = jax.devices(chosen)[0]
    return chosen
