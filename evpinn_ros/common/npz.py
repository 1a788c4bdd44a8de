"""Arrays from `.npz` files of anywhere: no pickle, and no more than they may hold."""

from __future__ import annotations

from pathlib import Path
from zipfile import ZipFile

import numpy as np


def read_arrays(path: Path, most_bytes: int) -> dict[str, np.ndarray]:
    """The arrays of a file by name, of up to `most_bytes` when unpacked.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no such file, holds more, or objects instead of numbers.
    """
    try:
        with ZipFile(path) as archive:
            # The sizes in the directory bind: zipfile unpacks no more of a member than that.
            size = sum(member.file_size for member in archive.infolist())
            if size > most_bytes:
                raise ValueError(f"{size} bytes of arrays, more than {most_bytes}")
        with np.load(path, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}
    except OSError:
        raise
    except Exception as error:
        # A header that lies makes zipfile, zlib, ast and numpy fail in as many ways.
        raise ValueError(f"not an .npz file of plain arrays: {error}") from error
