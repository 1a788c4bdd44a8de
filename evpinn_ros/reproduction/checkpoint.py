"""A training kept on disk: named arrays in one `.npz`, no pickle, replaced whole."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.fsync import replaced
from evpinn_ros.common.npz import read_arrays

MOST_BYTES = 256 << 20  # 4 x 128 units have 0.4 MB, a hundred steps of an optimiser's memory 80 MB


def save_checkpoint(path: Path, settings: str, state: Mapping[str, torch.Tensor]) -> None:
    """Write a state so that a crash leaves the old file or the new one whole.

    Args:
        path: of the file, ending in `.npz`.
        settings: what the state belongs to; `load_checkpoint` asks for it again.
        state: named tensors.

    Raises:
        InputError: it cannot be written.
    """
    arrays = {f"state/{name}": tensor.detach().cpu().numpy() for name, tensor in state.items()}
    names = np.array(sorted(arrays))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path) as draft, draft.open("wb") as file:
            np.savez(file, settings=np.array(settings), names=names, **arrays)  # type: ignore[arg-type]
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def load_checkpoint(path: Path, settings: str) -> dict[str, torch.Tensor] | None:
    """The state saved for these settings; None when there is none, or it cannot be read."""
    try:
        arrays = read_arrays(path, MOST_BYTES)
        if str(arrays["settings"]) != settings:
            return None
        return {
            name.removeprefix("state/"): torch.from_numpy(arrays[name])
            for name in arrays["names"].tolist()
        }
    except (OSError, KeyError, ValueError, TypeError):
        return None
