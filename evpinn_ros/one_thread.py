"""One thread for all linear algebra of this process."""

from __future__ import annotations

from threadpoolctl import threadpool_limits
import torch


def one_thread() -> None:
    """Let torch and BLAS compute in the calling thread alone.

    The matrices here are small: two threads need up to six times the processor's time of one, wait
    for each other where another process takes a core, and add in an order that differs.
    """
    torch.set_num_threads(1)
    threadpool_limits(1)
