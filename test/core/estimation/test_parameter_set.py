"""States of the parameters: how each is come to and left, and what is never valid."""

from dataclasses import replace
import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.estimation.parameter_set import (
    ESTIMATING_BELOW,
    OWN_VALID_BELOW,
    STAYS_BELOW,
    TYRES,
    UNOBSERVABLE_ABOVE,
    VALID_BELOW,
    TrustHysteresis,
    parameter_set,
)
from evpinn_ros.core.estimation.posterior import initial_state
from evpinn_ros.core.estimation.published import Driven, Published, published
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.detector import FAR_FROM_PRIOR
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES

UNESTIMATED, ESTIMATING, VALID, INVALID = (
    Trust.UNESTIMATED,
    Trust.ESTIMATING,
    Trust.VALID,
    Trust.INVALID,
)
CALM = dict.fromkeys(PARAMETER_NAMES, 0.0)
NULL = np.array([1.0, -1.0, 1.0, 0.0, 1.0, 0.0])  # what no power tells, in the logarithms


@pytest.fixture
def prior(vehicle) -> Published:
    equation = equation_of(vehicle)
    return published(initial_state(equation), equation, Driven.nowhere())


def learned(prior: Published, share: float, own: float = 0.0, **moved) -> Published:
    """All that data can determine known to this share of variance, `own` left of all together."""
    mean, covariance = prior.now
    mean = mean.copy()
    for name, value in moved.items():
        mean[PARAMETER_NAMES.index(name)] = value
    gauge = own * NULL * np.sqrt(covariance[0, 0])
    return prior._replace(
        now=prior.now._replace(mean=mean, covariance=share * covariance + np.outer(gauge, gauge))
    )


@pytest.mark.parametrize(
    ("share", "own", "state"),
    [
        (1.0, 0.0, UNESTIMATED),
        (ESTIMATING_BELOW - 0.01, 0.0, UNESTIMATED),  # its own prior is most of it
        (UNOBSERVABLE_ABOVE - 0.01, 0.0, ESTIMATING),
        (VALID_BELOW + 0.01, 0.0, ESTIMATING),
        (VALID_BELOW - 0.01, 0.0, VALID),
        (0.01, math.sqrt(OWN_VALID_BELOW - 0.05), VALID),
        (0.01, math.sqrt(OWN_VALID_BELOW + 0.05), ESTIMATING),  # mostly prior is never valid
        (0.01, math.sqrt(UNOBSERVABLE_ABOVE + 0.05), UNESTIMATED),
    ],
)
def test_states_by_what_the_data_have_told_of_all_and_of_each(prior, share, own, state):
    """States of eta by the shares of prior variance left in m / eta and in eta itself."""
    parameters = parameter_set(0, learned(prior, share, own))
    assert parameters.parameters["eta"].trust is state
    combined = parameters.identifiable_trust["mass_over_eta"]
    assert combined is (
        VALID if share < VALID_BELOW else ESTIMATING if share < ESTIMATING_BELOW else UNESTIMATED
    )
    assert parameters.reliable == (share < VALID_BELOW)


@pytest.mark.parametrize(
    "c_rr", [0.5 * TYRES.lower, 0.95 * TYRES.lower, 1.05 * TYRES.upper, 0.036]
)
def test_rolling_resistance_that_no_tyre_has_is_never_valid(prior, c_rr):
    judge = TrustHysteresis()
    good = judge.judge(parameter_set(0, learned(prior, 0.01, c_rr=0.01)), CALM, suspected=False)
    assert good.parameters["c_rr"].trust is VALID
    parameters = parameter_set(0, learned(prior, 0.01, c_rr=c_rr))
    assert parameters.parameters["c_rr"].trust is ESTIMATING
    later = judge.judge(parameters, CALM, suspected=False)
    assert later.parameters["c_rr"].trust is ESTIMATING, "not even where it was valid before"


@pytest.mark.parametrize(
    ("name", "value"), [("c_d", math.log(1.34)), ("c_d", math.log(0.08)), ("eta", math.log(1.2))]
)
def test_values_that_no_car_has_are_never_valid(prior, name, value):
    parameter = parameter_set(0, learned(prior, 0.001, **{name: value})).parameters[name]
    assert parameter.trust is ESTIMATING and not parameter.possible


def test_rolling_resistance_is_not_valid_where_a_climb_looks_like_it(prior):
    judge = TrustHysteresis()
    seen = learned(prior, 0.01, c_rr=0.01)
    good = judge.judge(parameter_set(0, seen), CALM, suspected=False)
    unseen = parameter_set(0, seen._replace(hills_seen=False))
    later = judge.judge(unseen, CALM, suspected=False)
    assert good.parameters["c_rr"].trust is VALID
    assert later.parameters["c_rr"].trust is ESTIMATING, "not even where it was valid before"
    assert later.parameters["mass"].trust is VALID and later.reliable


def test_an_efficiency_at_its_bound_is_published_as_an_interval(prior):
    """A normal logarithm cut off at 1, of 3 % sigma about 1.05."""
    source = learned(prior, 0.2, eta=math.log(1.05))
    eta = parameter_set(0, source).parameters["eta"]
    assert eta.lower < eta.value < eta.upper <= 1.0
    assert eta.lower < 0.98 and eta.upper > 0.99 and eta.std > 0.0
    rng = np.random.default_rng(0)
    std = math.sqrt(source.now.covariance[0, 0])
    draws = np.exp(math.log(1.05) + std * rng.standard_normal(400_000))
    draws = draws[draws <= 1.0]
    assert eta.value == pytest.approx(np.median(draws), abs=0.005)
    assert eta.upper == pytest.approx(np.quantile(draws, 0.975), abs=0.005)
    assert eta.lower >= np.quantile(draws, 0.025) - 0.005


@pytest.mark.parametrize("name", PARAMETER_NAMES)
def test_no_sigma_is_wider_than_the_values_that_there_are(prior, name):
    """`c_rr 0.10000, 1-sigma 72580` was of a log that no car could have made."""
    index = PARAMETER_NAMES.index(name)
    covariance = prior.now.covariance.copy()
    covariance[index, index] = 1e12
    unsure = parameter_set(0, prior._replace(now=prior.now._replace(covariance=covariance)))
    lower, upper = LIMITS[name]
    assert 0.0 <= unsure.parameters[name].std <= upper - lower


def test_bounds_by_hand(prior):
    """eta and mu in [q, 1]; mass and C_d in [q, 1] of theirs over eta, each two sigmas wider."""
    parameters = parameter_set(0, learned(prior, 0.01, eta=math.log(0.85), mu=math.log(0.75)))
    combined, std = parameters.identifiable, parameters.identifiable_std
    q = combined.regeneration - 2 * std.regeneration
    low, high = (combined.mass_over_eta + sign * 2 * std.mass_over_eta for sign in (-1, 1))
    assert parameters.parameters["mass"].lower == pytest.approx(q * low)
    assert parameters.parameters["mass"].upper == pytest.approx(high)
    widest = combined.drag_area_over_eta + 2 * std.drag_area_over_eta
    assert parameters.parameters["c_d"].upper == pytest.approx(widest / prior.frontal_area)
    assert parameters.parameters["eta"].lower >= q


class Judge:
    """One parameter through a `TrustHysteresis`."""

    def __init__(self, prior) -> None:
        self._judge, self._prior = TrustHysteresis(), prior

    def __call__(self, share, *, away: float = 0.0, suspected: bool = False) -> Trust:
        parameters = parameter_set(0, learned(self._prior, share))
        self.set = self._judge.judge(parameters, {**CALM, "mass": away}, suspected=suspected)
        return self.set.parameters["mass"].trust


@pytest.fixture
def judge(prior) -> Judge:
    return Judge(prior)


def test_valid_stays_until_much_is_forgotten(judge):
    assert [judge(share) for share in (1.0, 0.5, 0.2)] == [UNESTIMATED, ESTIMATING, VALID]
    assert judge(VALID_BELOW * STAYS_BELOW - 0.01) is VALID
    assert judge(VALID_BELOW * STAYS_BELOW + 0.01) is ESTIMATING
    # What it takes to come back is more than what it took to stay.
    assert judge(VALID_BELOW * STAYS_BELOW - 0.01) is ESTIMATING
    assert judge(0.93) is ESTIMATING and judge(1.01) is UNESTIMATED


def test_a_value_that_is_all_prior_again_is_unestimated(prior):
    """Whatever is known of its combination (`learned`: share of this, and own 1-sigma)."""
    judge = TrustHysteresis()

    def trust(own_share: float) -> Trust:
        parameters = parameter_set(0, learned(prior, 0.5)).parameters
        parameters["mass"] = replace(
            parameters["mass"],
            prior_share=own_share,
            trust=ESTIMATING if own_share < 0.9 else UNESTIMATED,
        )
        judged = judge.judge(
            replace(parameter_set(0, learned(prior, 0.5)), parameters=parameters),
            CALM,
            suspected=False,
        )
        return judged.parameters["mass"].trust

    assert [trust(own_share) for own_share in (0.8, 0.95, 1.0, 0.95)] == [
        ESTIMATING, ESTIMATING, UNESTIMATED, UNESTIMATED,
    ]  # fmt: skip


def test_an_impossible_value_is_invalid_until_it_is_well_possible_again(judge):
    assert judge(0.1, away=FAR_FROM_PRIOR.on - 0.1) is VALID
    assert judge(0.1, away=-FAR_FROM_PRIOR.on - 0.1) is INVALID and not judge.set.reliable
    assert judge(0.1, away=(FAR_FROM_PRIOR.off + FAR_FROM_PRIOR.on) / 2) is INVALID
    assert judge(0.1, away=FAR_FROM_PRIOR.off - 0.1) is VALID and judge.set.reliable


def test_a_suspicion_makes_all_invalid_while_it_lasts(judge):
    judge(0.1)
    assert judge(0.1, suspected=True) is INVALID
    assert {p.trust for p in judge.set.parameters.values()} == {INVALID}
    assert set(judge.set.identifiable_trust.values()) == {INVALID}
    assert judge(0.1) is VALID and VALID in judge.set.identifiable_trust.values()


def test_what_is_stale_was_valid(prior):
    parameters = parameter_set(0, learned(prior, 0.1))
    stale = parameters.stale()
    assert {p.trust for p in stale.parameters.values()} == {Trust.STALE}
    assert set(stale.identifiable_trust.values()) == {Trust.STALE} and not stale.reliable
    mass = replace(parameters.parameters["mass"], trust=ESTIMATING)
    assert (
        replace(parameters, parameters={"mass": mass}).stale().parameters["mass"].trust
        is ESTIMATING
    )


@pytest.mark.parametrize(("std", "state"), [(0.2, VALID), (0.3, ESTIMATING)])
def test_a_value_that_is_unsure_by_a_quarter_is_not_valid_however_wide_its_prior(
    prior, std, state
):
    """C_d of 0.9 +- 0.36 was, of a car without heights whose prior was wider still."""
    source = learned(prior, 0.01)
    c_d = PARAMETER_NAMES.index("c_d")
    source.now.covariance[c_d, c_d] = std**2
    wide = source.prior._replace(covariance=100.0 * source.prior.covariance)
    wide.covariance[c_d, c_d] = 10.0
    drag = parameter_set(0, source._replace(prior=wide)).parameters["c_d"]
    assert drag.trust is state


@pytest.mark.parametrize("beyond", [-9.0, 9.0])
def test_a_value_beyond_what_any_car_has_is_shown_at_its_limit(prior, beyond):
    """Means are logarithms for all but c_rr and p_aux, whose limits are passed in their unit."""
    away = {
        name: beyond * 1e4 if name in ("c_rr", "p_aux") else beyond for name in PARAMETER_NAMES
    }
    for name, estimate in parameter_set(0, learned(prior, 0.01, **away)).parameters.items():
        assert estimate.lower <= estimate.value <= estimate.upper
        assert LIMITS[name].lower <= estimate.lower and estimate.upper <= LIMITS[name].upper
