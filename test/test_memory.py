"""What glibc does with memory that is freed."""

from pathlib import Path
import subprocess
import sys

import pytest

PROGRAM = """
import sys
import numpy as np
from evpinn_ros.bench.soak import resident_mb
from evpinn_ros.memory import return_memory

if sys.argv[1] == "returned":
    return_memory()
np.ones(3_000_000)  # 24 MB: glibc takes the next ones of this size from its heap
blocks, between = [], []
for _ in range(8):
    blocks.append(np.ones(2_000_000))
    between.append(np.ones(15_000))
before = resident_mb("self")
blocks.clear()
print(before - resident_mb("self"))
"""


def freed_mb(how):
    command = [sys.executable, "-c", PROGRAM, how]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
def test_blocks_between_others_go_back_to_the_system():
    assert freed_mb("returned") > 100  # of 128, of which glibc by itself keeps all
