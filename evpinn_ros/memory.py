"""Memory that is no longer used goes back to the system."""

from __future__ import annotations

import ctypes

# mallopt(3)
_TRIM_THRESHOLD = -1
_MMAP_THRESHOLD = -3
LARGE = 128 * 1024  # bytes; glibc's own thresholds at the start of a process


def return_memory() -> None:
    """Hold glibc to give large blocks back when they are freed, for as long as the process lives.

    By itself it keeps ever larger ones, up to 32 MB, once the first was freed, and between what
    lives longer they leave holes: a node grew by a tenth in the first hours of driving. A C
    library without `mallopt` is left as it is.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, LARGE)
        mallopt(_TRIM_THRESHOLD, LARGE)
