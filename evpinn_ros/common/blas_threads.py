"""One thread for all linear algebra of this process."""

from __future__ import annotations

import os
import sys

from threadpoolctl import threadpool_limits


def limit_blas_threads() -> None:
    """Let torch and BLAS use one thread: small matrices are faster, and sums repeat."""
    threadpool_limits(1)
    os.environ["OMP_NUM_THREADS"] = "1"  # torch reads it at import
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(1)
