"""Every number of a saved state has a declared range, and nothing else gets in."""

from copy import deepcopy
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
import math
from types import NoneType
from typing import Annotated, get_args, get_origin, get_type_hints

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

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
    """Every place that is declared: its path, what is declared there, if it may be None, missing.

    A NamedTuple is one place: its numbers have one range.
    """
    hints = get_type_hints(declared, include_extras=True)
    for field in fields(declared):
        kinds = get_args(hints[field.name])
        maybe = NoneType in kinds
        kind = kinds[0] if maybe else hints[field.name]
        optional = field.default is not MISSING or field.default_factory is not MISSING
        path = (*prefix, field.name)
        if is_dataclass(kind):
            yield from leaves(kind, path)
        elif hasattr(kind, "_fields"):
            first = get_type_hints(kind, include_extras=True)[kind._fields[0]]
            yield path, first, maybe, optional
        else:
            yield path, kind, maybe, optional


def range_of(declared):
    """Range of a number, and whether it is whole; None of what is none."""
    if get_origin(declared) is not Annotated:
        return None
    kind, bounds = get_args(declared)
    return bounds.least, bounds.most, kind is int


PLACES = [
    (mode, ("learner", *path), inner, *may)
    for mode, declared in ((Mode.HYBRID, SavedPinn), (Mode.PAPER, SavedPaper))
    for path, inner, *may in leaves(declared)
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
    mode, path, declared, maybe, optional = place
    estimator = restored(mode)
    before = repr(estimator.export())
    wrongs = [value for value in WRONG if not (value is None and maybe)]
    if bool in (declared, *get_args(declared)):
        wrongs.remove(True)
    if path[1:] == ("current_suspicion", "sums"):
        wrongs = [wrong for wrong in wrongs if wrong not in ([], {})]  # all at its default
    if path[-1] == "regen_form":
        wrongs = [value for value in WRONG if not isinstance(value, str)]
    for value in wrongs:
        for change in (value, one_of(value)):
            if value is True and range_of(declared) and change is not True:
                continue  # numpy makes it one among numbers
            with pytest.raises(ValueError, match=path[-1]):
                estimator.restore(spoilt(states[mode], path, change))
    if not optional:
        other = spoilt(states[mode], path[:-1], lambda old: without(old, path[-1]))
        with pytest.raises(ValueError, match=path[-1]):
            estimator.restore(other)
    assert repr(estimator.export()) == before


def without(section, name):
    return {key: value for key, value in section.items() if key != name}


@pytest.mark.parametrize("place", PLACES, ids=lambda p: ".".join(p[1]))
@settings(max_examples=10, deadline=None, suppress_health_check=[*HealthCheck])
@given(data=st.data())
def test_whatever_is_saved_in_a_place_is_saved_again(new, states, place, data):
    """A field that an owner does not take, or does not save, fails it."""
    mode, path, declared, *_ = place
    if not range_of(declared) or path[-1] in ("way", "climb"):  # of a drive, which a restart ends
        return
    least, most, whole = range_of(declared)
    number = data.draw(st.integers(least, most) if whole else st.floats(least, most))
    state, estimator = spoilt(states[mode], path, one_of(number)), new(mode)
    try:
        estimator.restore(state)
    except ValueError:
        return
    saved, sent = estimator.export(), state
    for name in path:
        saved, sent = saved[name], sent[name]
    assert np.ravel(saved) == pytest.approx(np.ravel(sent), rel=1e-6)  # mode paper has float32


@pytest.mark.parametrize(
    "place",
    [each for each in PLACES if range_of(each[2]) and each[0] is Mode.HYBRID],
    ids=lambda p: ".".join(p[1]),
)
def test_the_ends_of_a_range_are_refused_or_good_for_finite_predictions(new, states, place, drive):
    mode, path, declared, *_ = place
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
