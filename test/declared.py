"""Strategies of Hypothesis for declared values."""

import math
from typing import Any

from hypothesis import strategies as st

from evpinn_ros.common.saved_fields import declared


def plain_fields(kind: Any, most: float = math.inf) -> st.SearchStrategy[dict[str, Any]]:
    """Any values within their ranges for all fields that are numbers or truth values.

    `most` bounds the numbers further.
    """
    values: dict[str, st.SearchStrategy[Any]] = {}
    for name, field in declared(kind).items():
        if field.kind is bool:
            values[name] = st.booleans()
        elif field.kind in (int, float) and field.range is not None:
            of_kind: Any = st.integers if field.kind is int else st.floats
            number = of_kind(field.range.least, min(field.range.most, most))
            values[name] = st.none() | number if field.optional else number
    return st.fixed_dictionaries(values)
