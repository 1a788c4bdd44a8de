"""Every number of a saved state has a declared range, and nothing else gets in."""

from copy import deepcopy
from dataclasses import is_dataclass
from functools import cache
import math
from types import NoneType
from typing import Annotated, get_args, get_origin, get_type_hints

import numpy as np
import pytest

from evpinn_ros.common.saved_fields import ADDED, Range
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, OnlineEstimator
from evpinn_ros.core.estimation.pinn import SavedPinn
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.extras.paper.learner import SavedPaper

pytestmark = pytest.mark.torch

WRONG = (1e300, -1e300, 10**400, math.nan, math.inf, "1", None, [], {}, [[1.0], [2.0, 3.0]], True)
CHANGE = {"stamp_ns": 1_700_000_000 * NANOSECONDS, "delta_mass": 150.0, "std": 30.0}
FOUND = {
    "stamp_ns": 1_700_000_000 * NANOSECONDS,
    "before": 7.7,
    "odds": 18.0,
    "mass": 2000.0,
    "motion": 300.0,
    "change": 0.07,
    "significance": 6.0,
    "rival": False,
}


def leaves(declared, prefix=()):
    """Every place that is declared, with what is declared there and whether it may be None.

    In place of that `ADDED`, where it may be missing too.
    """
    for name, inner in get_type_hints(declared, include_extras=True).items():
        bare = get_args(inner)[0] if get_origin(inner) is Annotated else inner
        part = get_args(bare)[0] if NoneType in get_args(bare) else bare
        maybe = NoneType in get_args(inner)
        kind = get_args(inner)[0] if maybe else inner
        if is_dataclass(part):
            yield from leaves(part, (*prefix, name))
        elif ADDED in get_args(inner):
            yield (*prefix, name), part, ADDED
        elif hasattr(kind, "_fields"):  # numbers of one range
            first = get_type_hints(kind, include_extras=True)[kind._fields[0]]
            yield (*prefix, name), first, maybe
        else:
            yield (*prefix, name), kind, maybe


def range_of(declared):
    """Range of a number, and whether it is whole; None of what is none."""
    if get_origin(declared) is not Annotated or get_args(declared)[0] is str:
        return None
    kind, *notes = get_args(declared)
    bounds = [note for note in notes if isinstance(note, Range)]
    return (bounds[0].least, bounds[0].most, kind is int) if bounds else None


PLACES = [
    (mode, ("learner", *path), inner, maybe)
    for mode, declared in ((Mode.HYBRID, SavedPinn), (Mode.PAPER, SavedPaper))
    for path, inner, maybe in leaves(declared)
    # Of the posterior and its sums `test_pinn` has the refusals: what fits is a matter of shapes.
    if path[0] not in ("car", "unevenness", "driven")
]


@pytest.fixture(scope="module")
def new(vehicle):
    return lambda mode: OnlineEstimator(
        vehicle, EstimatorSettings(mode=mode), InlineWorker(lambda: 0.0)
    )


@pytest.fixture(scope="module")
def states(new):
    """A full state of each mode: also with what is there only at times."""
    found = {mode: deepcopy(new(mode).export()) for mode in Mode}
    found[Mode.HYBRID]["learner"]["payload"].update(change=CHANGE, found=FOUND)
    found[Mode.HYBRID]["learner"]["seen_ns"] = 1_700_000_000 * NANOSECONDS
    found[Mode.HYBRID]["learner"]["car"]["celsius"] = 21.0
    return found


@pytest.fixture(scope="module")
def restored(new, states):
    """An estimator of a mode with the full state, of which nothing but refusals is asked."""

    @cache
    def of(mode: Mode) -> OnlineEstimator:
        estimator = new(mode)
        estimator.restore(states[mode])
        return estimator

    return of


def spoilt(state, path, value):
    if not path:
        return value(state) if callable(value) else value
    first, *rest = path
    return {**state, first: spoilt(state[first], rest, value)}


def one_of(value):
    """A list with one number in its middle replaced; a plain number replaced."""

    def change(old):
        if not isinstance(old, list):
            return value
        flat = np.array(old, dtype=object)
        flat.reshape(-1)[flat.size // 2] = value
        return flat.tolist()

    return change


@pytest.mark.parametrize("place", PLACES, ids=lambda p: ".".join(p[1]))
def test_no_place_takes_what_is_not_declared(restored, states, place):
    mode, path, declared, maybe = place
    estimator = restored(mode)
    before = repr(estimator.export())
    wrongs = [value for value in WRONG if not (value is None and maybe)]
    if declared is bool:
        wrongs.remove(True)
    if path[-1] == "regen_form":
        wrongs = [value for value in WRONG if not isinstance(value, str)]
    for value in wrongs:
        for change in (value, one_of(value)):
            if value is True and range_of(declared) and change is not True:
                continue  # numpy makes it one among numbers
            with pytest.raises(ValueError, match=path[-1]):
                estimator.restore(spoilt(states[mode], path, change))
    for key in ("new",) if maybe is ADDED else ("missing", "new"):
        other = spoilt(states[mode], path[:-1], lambda old, key=key: altered(old, path[-1], key))
        with pytest.raises(ValueError, match=rf"{path[-2]}|{path[-1]}"):
            estimator.restore(other)
    assert repr(estimator.export()) == before


def altered(section, name, key):
    rest = {k: v for k, v in section.items() if k != name}
    return rest if key == "missing" else {**section, "else": 1.0}


@pytest.mark.parametrize(
    "place",
    [each for each in PLACES if range_of(each[2]) and each[0] is Mode.HYBRID],
    ids=lambda p: ".".join(p[1]),
)
def test_the_ends_of_a_range_are_refused_or_good_for_finite_predictions(new, states, place, drive):
    mode, path, declared, _ = place
    least, most, whole = range_of(declared)
    readings = drive(1, 240.0).readings[1200:1240]
    for end in (least, most):
        number = int(end) if whole else end
        for change in (lambda old, n=number: filled(old, n), one_of(number)):
            estimator = new(mode)
            try:
                estimator.restore(spoilt(states[mode], path, change))
            except ValueError:
                continue
            for reading in readings:
                for output in estimator.add_reading(reading):
                    if hasattr(output, "power"):
                        assert math.isfinite(output.power) and math.isfinite(output.sigma)
            again = new(mode)
            again.restore(estimator.export())


def filled(old, number):
    return np.full(np.shape(old), number).tolist() if isinstance(old, list) else number
