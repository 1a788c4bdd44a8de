"""JSON without NaN and infinity."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
from typing import Any


def json_text(value: Any, indent: int | None = None) -> str:
    """Plain values as JSON; numbers that are not finite become null."""
    return json.dumps(_finite(value), indent=indent, allow_nan=False)


def _finite(content: Any) -> Any:
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if isinstance(content, Mapping):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return content
