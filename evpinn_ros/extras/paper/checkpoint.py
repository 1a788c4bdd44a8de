"""Saves a training on disk: named arrays in one `.npz` without pickle, replaced atomically."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import torch

from evpinn_ros.common.errors import InputError, as_input_error, one_line
from evpinn_ros.common.opener import check_file
from evpinn_ros.common.writer import replaced

# Of arrays: 4 x 128 units take 0.4 MB, an optimiser's memory of a hundred steps 80 MB.
MOST_BYTES = 256 << 20


def save_checkpoint(path: Path, settings: str, state: Mapping[str, torch.Tensor]) -> None:
    """Write a state with its `settings` to an .npz atomically."""
    arrays = {name: tensor.detach().cpu().numpy() for name, tensor in state.items()}
    with as_input_error(f"{path}: cannot be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path, update=True) as draft:
            np.savez(draft, settings=np.array(settings), **arrays)  # type: ignore[arg-type]


def adam_state(adam: torch.optim.Adam, weights: Iterable[torch.Tensor]) -> dict[str, torch.Tensor]:
    """Adam's moments of these weights, by the names of `load_adam_state`."""
    return {
        f"adam_{index}_{name}": value.detach().clone()
        for index, weight in enumerate(weights)
        for name, value in adam.state[weight].items()
    }


def load_adam_state(
    adam: torch.optim.Adam, weights: Iterable[torch.Tensor], state: Mapping[str, torch.Tensor]
) -> None:
    """Load Adam's moments from a state that contains an `adam_state`."""
    for index, weight in enumerate(weights):
        prefix = f"adam_{index}_"
        adam.state[weight] = {
            name.removeprefix(prefix): value.clone().to(weight.device)
            for name, value in state.items()
            if name.startswith(prefix)
        }


def load_checkpoint(path: Path, settings: str) -> dict[str, torch.Tensor] | None:
    """The state saved with these settings, or None; InputError if the file is damaged."""
    if not path.exists():
        return None
    try:
        check_file(path)
        with ZipFile(path) as archive:
            # zipfile unpacks no more of a member than its size in the directory.
            if sum(member.file_size for member in archive.infolist()) > MOST_BYTES:
                raise ValueError("its arrays are too large")
        with np.load(path, allow_pickle=False) as arrays:
            if str(arrays["settings"]) != settings:
                return None
            names = set(arrays.files) - {"settings"}
            return {name: torch.from_numpy(arrays[name]) for name in names}
    except Exception as error:
        # A wrong header makes zipfile, zlib, ast and numpy fail with any kind of error.
        reason = f"{one_line(error)}; delete it to train anew"
        raise InputError(f"{path}: the saved training cannot be read: {reason}") from error
