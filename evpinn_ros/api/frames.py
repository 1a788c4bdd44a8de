"""Metrics as DataFrames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.saved_fields import figures
from evpinn_ros.core.estimation.breakdown import Amount
from evpinn_ros.core.estimation.estimate import FIGURES

with optional_imports():
    import pandas as pd


def parameter_frame(parameters: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """The metrics under `parameters`, one row each."""
    return _rows(parameters, "parameter", tuple(FIGURES))


def breakdown_frame(breakdown: Mapping[str, Any]) -> pd.DataFrame:
    """The metrics under `breakdown`, one row for each part."""
    parts = {name: part for name, part in breakdown.items() if isinstance(part, dict)}
    return _rows(parts, "part", tuple(figures(Amount)))


def _rows(
    values: Mapping[str, Mapping[str, Any]], name: str, columns: tuple[str, ...]
) -> pd.DataFrame:
    table = pd.DataFrame.from_dict(values, orient="index", columns=list(columns))
    numbers = [column for column in columns if column != "state"]
    return table.astype(dict.fromkeys(numbers, float)).rename_axis(name)
