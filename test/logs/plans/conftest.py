"""Files of plans, written where a test may read them."""

from collections.abc import Callable
import json
from pathlib import Path
from typing import Any
import warnings

import pytest

from evpinn_ros.core.energy.plan import Legs, Plan
from evpinn_ros.logs.plans import read_plan
from evpinn_ros.logs.read_options import ReadOptions


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


@pytest.fixture
def at_pace(tmp_path: Path) -> Callable[[Any], tuple[Plan | Legs, list[str]]]:
    """The plan of a file at 20 m/s, and what its reader warns of."""

    def read(content: Any) -> tuple[Plan | Legs, list[str]]:
        path = tmp_path / "plan"
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            plan = read_plan(path, options=ReadOptions(pace=20.0))
        return plan, [str(warning.message) for warning in warned]

    return read
