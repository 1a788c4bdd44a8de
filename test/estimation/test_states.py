"""States of the parameters: how each is come to and left."""

import pytest

from evpinn_ros.estimation.estimate import ParameterEstimate, ParameterSet, State
from evpinn_ros.estimation.parameter_set import (
    ESTIMATING_BELOW,
    IMPOSSIBLE_BEYOND,
    POSSIBLE_WITHIN,
    STAYS_OBSERVABLE_BELOW,
    STAYS_VALID_ABOVE,
    UNOBSERVABLE_ABOVE,
    VALID_BELOW,
    StateKeeper,
    parameter_set,
)
from evpinn_ros.estimation.published_filter import PublishedFilter
from evpinn_ros.vehicle.identifiable import Identifiable
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

UNESTIMATED, ESTIMATING, VALID, INVALID = (
    State.UNESTIMATED,
    State.ESTIMATING,
    State.VALID,
    State.INVALID,
)
CALM = dict.fromkeys(PARAMETER_NAMES, 0.0)


def found(state: State, *, progress: float, share: float = 0.5) -> ParameterSet:
    estimate = ParameterEstimate(1.0, 0.1, share, 0.0, 2.0, state, progress)
    combined = Identifiable(1.0, 1.0, 1.0, 1.0, 1.0)
    return ParameterSet(0, dict.fromkeys(PARAMETER_NAMES, estimate), combined, combined, True)


class Judge:
    """One parameter through a `StateKeeper`."""

    def __init__(self) -> None:
        self._keeper = StateKeeper()

    def __call__(self, judged, *, deviation: float = 0.0, suspected: bool = False) -> State:
        away = {**CALM, "mass": deviation}
        self.set = self._keeper.judge(judged, away, suspected=suspected)
        return self.set.parameters["mass"].state


@pytest.fixture
def judge() -> Judge:
    return Judge()


def test_from_unestimated_to_valid_as_the_data_tell(judge):
    assert judge(found(UNESTIMATED, progress=0.0)) is UNESTIMATED
    assert judge(found(ESTIMATING, progress=30.0)) is ESTIMATING
    assert judge(found(VALID, progress=100.0)) is VALID


def test_valid_stays_until_much_is_forgotten(judge):
    judge(found(VALID, progress=100.0))
    assert judge(found(ESTIMATING, progress=STAYS_VALID_ABOVE + 1)) is VALID
    assert judge(found(ESTIMATING, progress=STAYS_VALID_ABOVE - 1)) is ESTIMATING
    # What it takes to come back is more than what it took to stay.
    assert judge(found(ESTIMATING, progress=STAYS_VALID_ABOVE + 1)) is ESTIMATING


def test_what_can_no_longer_be_told_is_unestimated(judge):
    judge(found(VALID, progress=100.0))
    little = STAYS_OBSERVABLE_BELOW - 0.01
    assert judge(found(UNESTIMATED, progress=100.0, share=little)) is VALID
    assert judge(found(UNESTIMATED, progress=20.0, share=little)) is ESTIMATING
    assert judge(found(UNESTIMATED, progress=20.0, share=0.99)) is UNESTIMATED


def test_an_impossible_value_is_invalid_until_it_is_well_possible_again(judge):
    judge(found(VALID, progress=100.0))
    assert judge(found(VALID, progress=100.0), deviation=IMPOSSIBLE_BEYOND - 0.1) is VALID
    assert judge(found(VALID, progress=100.0), deviation=-IMPOSSIBLE_BEYOND - 0.1) is INVALID
    assert not judge.set.reliable
    between = (POSSIBLE_WITHIN + IMPOSSIBLE_BEYOND) / 2
    assert judge(found(VALID, progress=100.0), deviation=between) is INVALID
    assert judge(found(VALID, progress=100.0), deviation=POSSIBLE_WITHIN - 0.1) is VALID
    assert judge.set.reliable


def test_a_suspicion_makes_all_invalid_while_it_lasts(judge):
    judge(found(VALID, progress=100.0))
    assert judge(found(VALID, progress=100.0), suspected=True) is INVALID
    assert {p.state for p in judge.set.parameters.values()} == {INVALID}
    assert judge(found(VALID, progress=100.0)) is VALID


@pytest.mark.parametrize(
    ("combined", "own", "state"),
    [
        (1.0, 1.0, UNESTIMATED),
        (ESTIMATING_BELOW + 0.01, 0.5, UNESTIMATED),
        (ESTIMATING_BELOW - 0.01, 0.5, ESTIMATING),
        (VALID_BELOW + 0.01, 0.5, ESTIMATING),
        (VALID_BELOW - 0.01, 0.5, VALID),
        (VALID_BELOW - 0.01, UNOBSERVABLE_ABOVE + 0.01, UNESTIMATED),
    ],
)
def test_states_by_what_the_data_have_told(vehicle, monkeypatch, combined, own, state):
    """Of C_d, by the shares of prior variance left in A C_d / eta and in C_d itself."""
    source = PublishedFilter(vehicle)
    mean, std, share = source.identifiable()
    monkeypatch.setattr(
        source, "identifiable", lambda: (mean, std, share._replace(drag_area_over_eta=combined))
    )
    shares = source.prior_share()._replace(c_d=own)
    monkeypatch.setattr(source, "prior_share", lambda: shares)
    assert parameter_set(0, source).parameters["c_d"].state is state
