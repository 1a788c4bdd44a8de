"""A saved car names its states: a file outlives a new state, and a damaged one is refused."""

from copy import deepcopy
from dataclasses import fields, replace
import json

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.common.saved_fields import StateError, plain, read
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.hybrid import HybridLearner
from evpinn_ros.core.estimation.posterior import CarState, initial_state
from evpinn_ros.core.estimation.saved_car import saved_state, state_of
from evpinn_ros.core.estimation.states import NAMES, OFFSETS, SAVED_BEFORE, SIZE, State
from evpinn_ros.core.estimation.terms import BESIDE, equation_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from test.core.estimation.conftest import measured
from test.declared import changes, plain_fields

CAR = load_vehicle("bmw_i3")
EQUATION = equation_of(CAR)
FRESH = initial_state(EQUATION)


@pytest.fixture(scope="module")
def town(intervals):
    """Five minutes of a car that is heavier than its prior, on a cold day."""
    drive = intervals((DriveKind.URBAN, 300.0, 0), begin_ns=0, celsius=5.0)
    return measured(EQUATION, drive, 1e3, seed=2, MASS_OVER_ETA=1.1)


@pytest.fixture(scope="module")
def learned_car(town) -> LearnedCar:
    return LearnedCar.new(EQUATION).after(town[:30]).begin_drive().after(town[30:])


@pytest.fixture(scope="module")
def learned(learned_car) -> CarState:
    state = learned_car.state
    assert state.last_drive > 0.0 and state.celsius is not None and state.known
    return state


def with_states(saved: CarState, order: list[int | None]) -> CarState:
    """A file with these of the states in this order; None is one that this version lacks.

    That one, as any state, has something in common with the others.
    """
    count, size = len(saved.evidence), len(saved.names)
    mean = np.reshape(saved.mean, (count, size))
    covariance = np.reshape(saved.covariance, (count, size, size))
    like = [State.MASS_OVER_ETA if place is None else place for place in order]
    own = covariance[:, like][:, :, like]
    names = [f"of_later_{k}" if i is None else saved.names[i] for k, i in enumerate(order)]
    return replace(
        saved,
        names=tuple(names),
        mean=mean[:, like].ravel(),
        covariance=own.ravel(),
        offset_variance=saved.offset_variance[like],
    )


def assert_same(state: CarState, other: CarState) -> None:
    for field in fields(CarState):
        values = getattr(state, field.name), getattr(other, field.name)
        np.testing.assert_equal(*values, err_msg=field.name)


@settings(max_examples=20, deadline=None)
@given(plain_fields(CarState))
def test_every_field_survives_the_file(learned, values):
    state = replace(learned, **values)
    saved = read(CarState, json.loads(json.dumps(plain(saved_state(state)))))
    assert_same(state_of(saved, EQUATION), state)


# Of the drive, of an update under way and of this process: a restart begins them anew.
OF_THE_PROCESS = (
    *("equation", "dropout", "end_ns", "ended", "gated", "known_ns", "number", "parts"),
    *("rehearsals", "steps", "stretches"),
)


def test_every_field_of_a_learned_car_is_saved_or_ends_with_the_process(learned_car):
    learner = HybridLearner(CAR)

    def saved(car):
        learner._car = car
        return repr(learner.export())

    before = saved(learned_car)
    kept = changes(learned_car, but=OF_THE_PROCESS)
    assert not {path for path, car in kept if saved(car) == before}


def test_every_field_of_a_learned_car_counts_in_predictions_or_is_of_learning(learned):
    """A field that `CarModel` forgets is a forecast that differs from the command's."""

    def model(state):
        return repr(plain(replace(state.model(EQUATION), equation=None)))

    unused = {path for path, state in changes(learned) if model(state) == model(learned)}
    expected = {"offset_variance", "drives", "names", "bands.drive.cases", "bands.drive.squares"}
    assert unused == {*expected, "known", "intervals"}  # of a drive in which was learned already


@settings(max_examples=10, deadline=None)
@given(st.permutations(range(SIZE)))
def test_the_order_of_states_in_a_file_means_nothing(learned, order):
    assert_same(state_of(with_states(saved_state(learned), order), EQUATION), learned)


@settings(max_examples=20, deadline=None)
@given(st.sets(st.integers(0, SIZE - 1), min_size=1, max_size=3))
def test_a_state_that_a_file_lacks_begins_at_its_prior(learned, missing):
    kept = [index for index in range(SIZE) if index not in missing]
    restored = state_of(with_states(saved_state(learned), kept), EQUATION)
    lacked = sorted(missing)
    np.testing.assert_array_equal(restored.mean[:, lacked], FRESH.mean[:, lacked])
    block = np.ix_(range(len(FRESH.mean)), lacked, lacked)
    np.testing.assert_array_equal(restored.covariance[block], FRESH.covariance[block])
    assert not restored.covariance[:, lacked][:, :, kept].any()  # tells nothing of the others
    np.testing.assert_array_equal(restored.mean[:, kept], learned.mean[:, kept])
    theirs = np.ix_(range(len(FRESH.mean)), kept, kept)
    np.testing.assert_array_equal(restored.covariance[theirs], learned.covariance[theirs])
    for place, state in enumerate(OFFSETS):
        source = FRESH if state in missing else learned
        assert restored.offset_variance[place] == source.offset_variance[place]


def test_a_state_that_was_renamed_is_read_by_its_former_name(learned):
    saved, former = saved_state(learned), {new: old for old, new in SAVED_BEFORE.items()}
    names = tuple(former.get(name, name) for name in saved.names)
    assert_same(state_of(replace(saved, names=names), EQUATION), learned)


def test_a_state_of_a_later_version_is_left_out(learned):
    later = with_states(saved_state(learned), [None, *range(SIZE), None])
    assert_same(state_of(later, EQUATION), learned)


@pytest.fixture(scope="module")
def saved(town) -> dict:
    """What a learner saves after that drive."""
    learner = HybridLearner(CAR)
    for interval in town:
        learner.add_interval(interval)
    update = learner.prepare_update()
    assert update is not None and learner.consider(update()) is None
    return json.loads(json.dumps(learner.export()))


def without(saved: dict, state: State) -> dict:
    """The file as it was before a state was added."""
    older, count = deepcopy(saved), len(FRESH.mean)
    car = older["car"]
    at = car["names"].index(NAMES[state])
    covariance = np.reshape(car["covariance"], (count, SIZE, SIZE))
    shorter = np.delete(np.delete(covariance, at, 1), at, 2)
    car["covariance"] = shorter.ravel().tolist()
    car["mean"] = np.delete(np.reshape(car["mean"], (count, SIZE)), at, 1).ravel().tolist()
    for names in (car["names"], car["offset_variance"]):
        del names[at]
    if state in BESIDE:
        for row in (older["driven"]["names"], *older["driven"]["cross"]):
            del row[BESIDE.index(state)]
    return older


@pytest.mark.parametrize("state", [State.TURNING, State.LOAD_DRIVE])
def test_a_car_of_an_older_version_goes_on_learning(saved, town, state):
    older, same = HybridLearner(CAR), HybridLearner(CAR)
    older.restore(without(saved, state))
    same.restore(saved)
    model, before = older.model(), same.model()
    assert model.mean[State.MASS_OVER_ETA] == pytest.approx(
        before.mean[State.MASS_OVER_ETA], rel=1e-12
    )
    assert model.mean[state] == pytest.approx(EQUATION.mean[state])
    for interval in town[:10]:
        older.add_interval(interval)
    update = older.prepare_update()
    assert update is not None and older.consider(update()) is None
    assert older.export()["car"]["names"] == [*NAMES]


def test_of_a_state_that_a_file_lacks_its_driving_has_nothing(saved):
    older, learner, cross = deepcopy(saved), HybridLearner(CAR), np.array(saved["driven"]["cross"])
    assert cross[:, BESIDE.index(State.TURNING)].any()
    learner.restore(without(saved, State.TURNING))
    cross[:, BESIDE.index(State.TURNING)] = 0.0
    assert learner.export()["driven"]["cross"] == cross.tolist()
    del older["driven"]["cross"][0][-1]
    with pytest.raises(StateError):
        learner.restore(older)


def shorter(car: dict, name: str, _: float) -> None:
    car[name] = car[name][:-1]
