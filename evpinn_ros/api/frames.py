"""Metrics as DataFrames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evpinn_ros.common.optional import optional_imports

with optional_imports():
    import pandas as pd


PARAMETER_COLUMNS = ("value", "std", "prior_share", "lower", "upper", "state")
AMOUNT_COLUMNS = ("kwh", "sigma_kwh", "kwh_per_100km", "share")


def parameter_frame(found: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """The metrics under `parameters`, one row each."""
    return _rows(found, "parameter", PARAMETER_COLUMNS)


def breakdown_frame(found: Mapping[str, Any]) -> pd.DataFrame:
    """The metrics under `breakdown`, one row for each part."""
    parts = {name: part for name, part in found.items() if isinstance(part, dict)}
    return _rows(parts, "part", AMOUNT_COLUMNS)


def _rows(
    found: Mapping[str, Mapping[str, Any]], name: str, columns: tuple[str, ...]
) -> pd.DataFrame:
    table = pd.DataFrame.from_dict(found, orient="index", columns=list(columns))
    numbers = [column for column in columns if column != "state"]
    return table.astype(dict.fromkeys(numbers, float)).rename_axis(name)
