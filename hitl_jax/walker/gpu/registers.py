"""Arrays of registers and constants: NumPy arrays of objects."""

from collections.abc import Sequence
from typing import Any

import numpy as np


def array_of(elements: Sequence[Any], shape: Sequence[int]) -> np.ndarray:
    """Elements as an array of objects; NumPy itself would convert constants to numbers.

    Args:
        elements: registers and constants, in the array's order.
        shape: of the array.
    """
    flat = np.empty(len(elements), object)
    for place, element in enumerate(elements):
        flat[place] = element
    return flat.reshape(shape)


def elements_of(value: np.ndarray) -> list[Any]:
    """An array's elements, in order."""
    flat = value.reshape(-1)
    return [flat[place] for place in range(len(flat))]


def elements_of_all(values: Sequence[np.ndarray]) -> list[Any]:
    """The elements of several arrays, one array after the other."""
    return [element for value in values for element in elements_of(value)]
