"""Arithmetic that serves numpy and torch alike; torch is loaded by those who bring a tensor."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

Columns = TypeVar("Columns", bound=tuple[Any, ...])


def namespace(array: Any) -> Any:
    """numpy, or torch for its tensors."""
    if type(array).__module__.partition(".")[0] != "torch":
        return np
    import torch

    return torch


def like(array: np.ndarray, example: Any) -> Any:
    """A numpy array as whatever the example is."""
    if namespace(example) is np:
        return array
    return namespace(example).as_tensor(array, dtype=example.dtype, device=example.device)


def within(values: Any, low: float, high: float) -> Any:
    """Values between two bounds; for a few numbers `numpy.clip` takes five times as long."""
    if namespace(values) is np:
        return np.minimum(np.maximum(values, low), high)
    return values.clip(low, high)


def zeros(shape: tuple[int, ...], example: Any) -> Any:
    """Zeros of the kind of the example."""
    return np.zeros(shape) if namespace(example) is np else example.new_zeros(shape)


def chosen_rows(columns: Columns, chosen: np.ndarray) -> Columns:
    """A NamedTuple of arrays, shape (n,) each: the rows at some indices, or under a mask."""
    return type(columns)(*(column[chosen] for column in columns))
