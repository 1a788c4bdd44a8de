"""Schema of a saved state: every number of it is declared here with its range.

Whoever adds to a state adds it here: a state with other keys is refused, and the tests save and
restore one. Shapes are those of a state that nothing was learned for. What ranges cannot express
(a covariance is none, a car far from its vehicle file) the parts themselves refuse.
"""

from __future__ import annotations

from collections.abc import Mapping
import reprlib
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.estimation.calibration import RATIO_RANGE
from evpinn_ros.estimation.car_filter import SCALE_RANGE
from evpinn_ros.estimation.car_state import DRIVES_KEPT, PRIOR_DRIVES
from evpinn_ros.estimation.gaussian import MOST
from evpinn_ros.estimation.published import MOST_ENERGY, SUMS
from evpinn_ros.estimation.residual_network import MOST_EVIDENCE
from evpinn_ros.signals.road import TEMPERATURES

MOST_MASS = 1e6  # kg, and W
MOST_SUM = 1e15  # of squares and products over a car's life


class Range(NamedTuple):
    """Numbers from `least` to `most`; `whole` ones are integers."""

    least: float
    most: float
    whole: bool = False


class Maybe(NamedTuple):
    """Such a thing, or None."""

    declared: Declared


Declared: TypeAlias = Range | Maybe | type | Mapping[str, Any]

STAMP = Range(0, 2**62, whole=True)  # ns; to the year 2116
SUM, SQUARES = Range(-MOST_SUM, MOST_SUM), Range(0.0, MOST_SUM)
CHANCE = {"count": SQUARES, "squares": SQUARES}
HYBRID = {
    "filter": {
        "mean": Range(-MOST, MOST),
        "covariance": Range(-(MOST**2), MOST**2),
        "evidence": SUM,
        "scale": Range(*SCALE_RANGE),
        "drive_variance": Range(0.0, 1e8),
        "drives": Range(PRIOR_DRIVES, DRIVES_KEPT),
        "intervals": Range(0, 10**12, whole=True),
        "seconds": Range(0.0, 1e7),
        "hills": Range(0.0, 1e3),
    },
    "energies": {
        **dict.fromkeys(SUMS, Range(0.0, MOST_ENERGY)),
        "celsius": Maybe(Range(*TEMPERATURES)),
        "load_known": bool,
    },
    "payload": {
        "chance": CHANCE,
        "change": Maybe(
            {
                "stamp_ns": STAMP,
                "delta_mass": Range(-MOST_MASS, MOST_MASS),
                "std": Range(0.0, MOST_MASS),
            }
        ),
        "found": Maybe(
            {
                "stamp_ns": STAMP,
                "before": Range(-100.0, 100.0),
                "before_std": Range(0.0, 100.0),
                "mass": Range(0.0, MOST_MASS),
                "motion": Range(0.0, 1e9),
                "change": Range(-100.0, 100.0),
                "significance": Range(0.0, 1e6),
                "rival": bool,
            }
        ),
    },
    "rehearsals": CHANCE,
    "loads": {
        "mean": Range(-MOST_MASS, MOST_MASS),
        "covariance": Range(-(MOST_MASS**2), MOST_MASS**2),
        "reported": bool,
        "drive": SQUARES,
    },
    "grade_suspicion": {"suspected": bool, "sums": SUM},
    "current_suspicion": {"suspected": bool, "told": bool, "sums": SUM},
    "network": Range(-MOST_EVIDENCE, MOST_EVIDENCE),
    "seen_ns": Maybe(STAMP),
}
PAPER = {
    "network": Range(-MOST, MOST),
    "log_scale": Range(-100.0, 100.0),
    "p_aux": Range(-MOST_MASS, MOST_MASS),
    "covariance": Range(-MOST, MOST),
    "variance": SQUARES,
    "fresh": bool,
    "regen_form": str,
}
_BANDS = Range(*RATIO_RANGE)


def check_state(saved: Mapping[str, Any], like: Mapping[str, Any]) -> None:
    """Refuse a state that is not what was declared.

    Args:
        saved: of the same version, vehicle and mode.
        like: the state of the same estimator when nothing was learned, for its shapes.

    Raises:
        ValueError: with the place and what was expected there.
    """
    learner = PAPER if like["mode"] == "paper" else HYBRID
    bands = dict.fromkeys(like["bands"], _BANDS)
    _check({"learner": learner, "bands": bands}, saved, like, "")


def _check(declared: Declared, value: Any, like: Any, where: str) -> None:
    if isinstance(declared, Mapping):
        if not isinstance(value, Mapping) or (where and set(value) != set(declared)):
            raise ValueError(f"'{where}' is {reprlib.repr(value)}, expected {', '.join(declared)}")
        for name, inner in declared.items():
            shape = like[name] if isinstance(like, Mapping) else None
            _check(inner, value.get(name), shape, f"{where}.{name}" if where else name)
    elif isinstance(declared, Maybe):
        if value is not None:
            _check(declared.declared, value, like, where)
    elif isinstance(declared, Range):
        _check_numbers(declared, value, () if like is None else np.shape(like), where)
    elif type(value) is not declared:
        raise ValueError(f"'{where}' is {reprlib.repr(value)}, expected {declared.__name__}")


def _check_numbers(declared: Range, value: Any, shape: tuple[int, ...], where: str) -> None:
    """Numbers of this shape; neither text nor truth values, which numpy would take for some."""
    least, most, whole = declared
    try:
        numbers = np.array(value)
    except ValueError:  # lists of several lengths
        numbers = np.array(None)
    fits = numbers.shape == shape and numbers.dtype.kind in ("iu" if whole else "iuf")
    if not (fits and ((numbers >= least) & (numbers <= most)).all()):
        size = f" in the shape {shape}" if shape else ""
        what = "an integer" if whole else "a number"
        raise ValueError(
            f"'{where}' is {reprlib.repr(value)}, expected {what} of {least:g} to {most:g}{size}"
        )
