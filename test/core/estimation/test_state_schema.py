"""Every number of a saved state has a declared range and outlives a file; nothing else gets in."""

from copy import deepcopy
from dataclasses import is_dataclass
from functools import cache
import math

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.common.saved_fields import Range, declared
from evpinn_ros.core.energy.account import EnergyAccount, SavedAccount
from evpinn_ros.core.energy.meter import EnergyMeter
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, OnlineEstimator
from evpinn_ros.core.estimation.hybrid import SavedHybrid
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.extras.paper.learner import SavedPaper

pytestmark = pytest.mark.torch

ACCOUNT = "account"
WRONG = (1e300, -1e300, 10**400, math.nan, math.inf, "1", None, [], {}, [[1.0], [2.0, 3.0]], True)
STAMP = 1_700_000_000 * NANOSECONDS
CHANGE = {"stamp_ns": STAMP, "delta_mass": 150.0, "std": 30.0}
ROUTE = {
    "distance": [0.0, 1e4],
    "energy": [0.0, 6e6],
    "sigma": [0.0, 1e5],
    "begin": 0.0,
    "begin_ns": STAMP,
    "longest_ns": 1200 * NANOSECONDS,
}


def leaves(kind, prefix=()):
    """Every place that is declared, with its declaration; of a NamedTuple each item."""
    for name, field in declared(kind).items():
        path = (*prefix, name)
        if is_dataclass(field.kind):
            yield from leaves(field.kind, path)
        elif hasattr(field.kind, "_fields"):
            for index, item in enumerate(declared(field.kind).values()):
                yield (*path, index), item._replace(lackable=True)
        else:
            yield path, field


PLACES = [
    (mode, (*prefix, *path), field)
    for mode, kind, prefix in (
        (Mode.HYBRID, SavedHybrid, ("learner",)),
        (Mode.PAPER, SavedPaper, ("learner",)),
        (ACCOUNT, SavedAccount, ()),
    )
    for path, field in leaves(kind)
    # `test_hybrid` has the refusals of the posterior and its sums: shapes must fit.
    if path[0] not in ("car", "driven", "uneven")
]
every_place = pytest.mark.parametrize("place", PLACES, ids=lambda p: ".".join(map(str, p[1])))


@pytest.fixture(scope="module")
def new(vehicle):
    def of(mode):
        if mode == ACCOUNT:
            return EnergyAccount(EnergyMeter(load_rknn()), vehicle.key, vehicle.battery_capacity)
        return OnlineEstimator(vehicle, EstimatorSettings(mode=mode), InlineWorker(lambda: 0.0))

    return of


@pytest.fixture(scope="module")
def states(new):
    """A full state of each: also with what is there only at times."""
    full = {mode: deepcopy(new(mode).export()) for mode in (*Mode, ACCOUNT)}
    payload = {"change": CHANGE, "before": [80.0, 20.0], "begin_ns": STAMP}
    full[Mode.HYBRID]["learner"]["payload"].update(payload)
    full[Mode.HYBRID]["learner"]["seen_ns"] = STAMP
    account = full[ACCOUNT]
    for gauge, capacity in ((account["charge"], 2e8), (account["battery"]["full_charge"], 5e5)):
        gauge.update(capacity=[capacity, capacity / 100], learned=3, step=0.01)
    account["battery"].update(samples=99, state=[350.0, 50.0, 0.1])
    account["battery"].update(covariance=np.eye(3).ravel().tolist())
    for integral in (account["meter"]["measured"], account["meter"]["predicted"]):
        integral.update(drawn=1e6, covered_s=1e3)
    account.update(route=ROUTE)
    return full


@pytest.fixture(scope="module")
def restored(new, states):
    """An owner with the full state, of which nothing but refusals is asked."""

    @cache
    def of(mode):
        owner = new(mode)
        owner.restore(states[mode])
        return owner

    return of


def spoilt(state, path, value):
    if not path:
        return value(state) if callable(value) else value
    first, *rest = path
    if isinstance(state, list):
        return [spoilt(item, rest, value) if i == first else item for i, item in enumerate(state)]
    return {**state, first: spoilt(state[first], rest, value)}


def content_of(state, path):
    for name in path:
        state = state[name]
    return state


def one_of(value):
    """A list with one number in its middle replaced; a plain number replaced."""

    def change(old):
        if not isinstance(old, list):
            return value
        flat = np.array(old, dtype=object)
        flat.reshape(-1)[flat.size // 2] = value
        return flat.tolist()

    return change


def wrongs_of(field):
    """Values that are not what is declared."""
    if field.range is None and field.kind not in (bool, int, str):  # a tuple
        return [value for value in WRONG if not isinstance(value, list)]
    nothing = field.optional or (field.range is not None and field.range.unknown)
    allowed = {bool: True, str: "1"}.get(field.kind)
    return [
        value
        for value in WRONG
        if not (value is None and nothing) and (value is not allowed or allowed is None)
    ]


def test_every_number_has_a_range():
    assert not [path for _, path, field in PLACES if field.kind is float and field.range is None]


@every_place
def test_no_place_takes_what_is_not_declared(restored, states, place):
    mode, path, field = place
    owner, name = restored(mode), [key for key in path if isinstance(key, str)][-1]
    before = repr(owner.export())
    for value in wrongs_of(field):
        for change in (value, one_of(value)):
            if value is True and field.range and change is not True:
                continue  # numpy makes it one among numbers
            if isinstance(content_of(states[mode], path), list) and field.range is None:
                change = value
            with pytest.raises(ValueError, match=name):
                owner.restore(spoilt(states[mode], path, change))
    if not field.lackable:
        lacking = dict(content_of(states[mode], path[:-1]))
        del lacking[name]
        with pytest.raises(ValueError, match=name):
            owner.restore(spoilt(states[mode], path[:-1], lacking))
    assert repr(owner.export()) == before


@every_place
@settings(max_examples=5, deadline=None, suppress_health_check=[*HealthCheck])
@given(data=st.data())
def test_whatever_is_saved_in_a_place_is_saved_again(new, states, place, data):
    """A field that an owner does not take, or does not save, fails it."""
    mode, path, field = place
    if field.range is None or path[-1] in ("way", "climb"):  # of a drive, which a restart ends
        return
    least, most = field.range[:2]
    most = data.draw(st.sampled_from((most, min(most, least + 1e3))))
    numbers = st.integers(least, most) if field.kind is int else st.floats(least, most)
    state, owner = spoilt(states[mode], path, one_of(data.draw(numbers))), new(mode)
    try:
        owner.restore(state)
    except ValueError:
        return
    saved, sent = (np.ravel(content_of(document, path)) for document in (owner.export(), state))
    assert saved == pytest.approx(sent, rel=1e-6)  # mode paper has float32


@pytest.mark.parametrize(
    "place",
    [place for place in PLACES if place[2].range and place[0] is Mode.HYBRID],
    ids=lambda p: ".".join(map(str, p[1])),
)
def test_the_ends_of_a_range_are_refused_or_good_for_finite_predictions(new, states, place, drive):
    mode, path, field = place
    bounds: Range = field.range
    readings = drive(1, 240.0).readings[1200:1240]
    for number in map(field.kind if field.kind is int else float, bounds[:2]):
        for change in (lambda old, n=number: filled(old, n), one_of(number)):
            estimator = new(mode)
            try:
                estimator.restore(spoilt(states[mode], path, change))
            except ValueError:
                continue
            for output in estimator.add_readings(readings):
                if hasattr(output, "power"):
                    assert math.isfinite(output.power) and math.isfinite(output.sigma)
            again = new(mode)
            again.restore(estimator.export())


def filled(old, number):
    return np.full(np.shape(old), number).tolist() if isinstance(old, list) else number
