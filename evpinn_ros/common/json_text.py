"""JSON for scripts."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
from typing import Any


def json_text(found: Any, indent: int | None = None) -> str:
    """Plain values as JSON; null where a number is not finite, which JSON does not know."""
    return json.dumps(_finite(found), indent=indent, allow_nan=False)


def _finite(found: Any) -> Any:
    if isinstance(found, float):
        return found if math.isfinite(found) else None
    if isinstance(found, Mapping):
        return {key: _finite(value) for key, value in found.items()}
    if isinstance(found, list | tuple):
        return [_finite(value) for value in found]
    return found
