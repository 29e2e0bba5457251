"""Networks that come with the package: `trained_human.md` says how they were made."""

import io
from importlib import resources

import numpy as np

from hitl_jax.types import Params


def load(file: str, prefix: str, package: str = "hitl_jax.human") -> tuple[Params, list[int]]:
    """Parameters of a stack of dense layers.

    Args:
        file: arrays `PREFIX/params/Dense_N/kernel` and `.../bias`, float32.
        prefix: of their names.
        package: where the file is.

    Returns:
        The parameters, kernels [I, O] and biases [O], and the width O of each layer.
    """
    layers: dict[str, dict[str, np.ndarray]] = {}
    with np.load(io.BytesIO((resources.files(package) / file).read_bytes())) as arrays:
        for name in arrays:
            if name.startswith(f"{prefix}/"):
                _, _, layer, part = name.split("/")
                layers.setdefault(layer, {})[part] = arrays[name]
    widths = [len(layers[f"Dense_{place}"]["bias"]) for place in range(len(layers))]
    return {"params": layers}, widths


def to_npz(params: Params, prefix: str) -> bytes:
    """The file that `load` reads."""
    arrays = {
        f"{prefix}/params/{layer}/{part}": np.asarray(array)
        for layer, parts in params["params"].items()
        for part, array in parts.items()
    }
    data = io.BytesIO()
    np.savez(data, **arrays)  # type: ignore[arg-type]
    return data.getvalue()
