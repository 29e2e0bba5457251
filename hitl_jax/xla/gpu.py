"""Whether programs are traced for a GPU that has the instructions of our kernels."""

import jax

_MIN_CAPABILITY = 8.0
"""Compute capability whose instructions the kernels use."""


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
