"""Files of plans, written where a test may read them."""

from collections.abc import Callable
import json
from pathlib import Path
from typing import Any

import pytest

from evpinn_ros.core.energy.plan import Legs, Plan
from evpinn_ros.logs.plans import read_plan


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Plan | Legs]:
    """The plan of a file of this content: text, bytes, or what becomes JSON."""

    def read(content: Any, name: str = "plan") -> Plan | Legs:
        path = tmp_path / name
        if isinstance(content, dict | list):
            content = json.dumps(content)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_plan(path)

    return read
