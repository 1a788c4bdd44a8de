"""From the filter's state to what is published: values, bounds, shares and states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math

import numpy as np

from evpinn_ros.estimation.estimate import ParameterEstimate, ParameterSet, State
from evpinn_ros.estimation.parameter_filter import ParameterFilter
from evpinn_ros.vehicle.parameters import LIMITS, PARAMETER_NAMES, Limits

ESTIMATING_BELOW = 0.95  # of the prior's variance left in the combination, then learning shows
VALID_BELOW = 0.25  # then the data have told the combination
UNOBSERVABLE_ABOVE = 0.9  # of the parameter's own prior variance: the data cannot tell it
# The identifiable combination on which each parameter rests.
RESTS_ON = {
    "eta": "mass_over_eta",
    "mu": "regeneration",
    "mass": "mass_over_eta",
    "c_rr": "c_rr",
    "c_d": "drag_area_over_eta",
    "p_aux": "p_aux",
}
BOUND_SIGMAS = 2.0
STAYS_VALID_ABOVE = 66.0  # percent of progress: until 0.4 of the prior's variance is back
STAYS_OBSERVABLE_BELOW = 0.93  # share until which what was told counts as told
IMPOSSIBLE_BEYOND = 6.0  # prior sigmas, then the value is no car's of this model
POSSIBLE_WITHIN = 5.0  # where a value that was impossible is believed again
RELIABLE_NEEDS = ("mass_over_eta", "regeneration")


def parameter_set(stamp_ns: int, source: ParameterFilter) -> ParameterSet:
    """Everything that is known of the parameters, from the filter."""
    value, std, share = source.parameters(), source.parameter_std(), source.prior_share()
    combined, combined_std, combined_share = source.identifiable()
    bounds = _bounds(source)
    parameters = {}
    for name in PARAMETER_NAMES:
        limits = bounds[name]
        parameters[name] = ParameterEstimate(
            value=float(np.clip(getattr(value, name), limits.lower, limits.upper)),
            std=getattr(std, name),
            prior_share=getattr(share, name),
            lower=limits.lower,
            upper=limits.upper,
            state=_state(getattr(combined_share, RESTS_ON[name]), getattr(share, name)),
            progress=_progress(getattr(combined_share, RESTS_ON[name])),
        )
    reliable = all(getattr(combined_share, name) < VALID_BELOW for name in RELIABLE_NEEDS)
    return ParameterSet(stamp_ns, parameters, combined, combined_std, reliable)


class StateKeeper:
    """States that do not flicker: what holds goes on holding a little beyond where it began."""

    def __init__(self) -> None:
        """Nothing judged yet."""
        self._states: dict[str, State] = {}

    def judge(
        self, found: ParameterSet, deviations: Mapping[str, float], *, suspected: bool
    ) -> ParameterSet:
        """The set with states that have hysteresis.

        Args:
            found: as made by `parameter_set`.
            deviations: of each parameter from its prior, in prior sigmas.
            suspected: whether the signals contradict each other.
        """
        parameters = {
            name: replace(p, state=self._next(name, p, deviations[name], suspected))
            for name, p in found.parameters.items()
        }
        self._states = {name: p.state for name, p in parameters.items()}
        wrong = State.INVALID in self._states.values()
        return replace(found, parameters=parameters, reliable=found.reliable and not wrong)

    def _next(self, name: str, now: ParameterEstimate, deviation: float, suspected: bool) -> State:
        before = self._states.get(name)
        limit = POSSIBLE_WITHIN if before is State.INVALID else IMPOSSIBLE_BEYOND
        if suspected or abs(deviation) > limit:
            return State.INVALID
        told = now.prior_share <= STAYS_OBSERVABLE_BELOW
        if before is State.VALID and told and now.progress >= STAYS_VALID_ABOVE:
            return State.VALID
        if now.state is State.UNESTIMATED and before in (State.VALID, State.ESTIMATING) and told:
            return State.ESTIMATING if now.progress > 0.0 else State.UNESTIMATED
        return now.state


def _bounds(source: ParameterFilter) -> dict[str, Limits]:
    """Bounds that need no belief in an absolute value: eta <= 1 and mu <= 1 bound the rest.

    With q = eta mu known, eta and mu lie in [q, 1], hence mass in [q, 1] m/eta and likewise C_d;
    each combination is widened by `BOUND_SIGMAS`. Until the data have told a combination, the
    limits of the parameter stand.
    """
    mean, std, share = source.identifiable()
    bounds = dict(LIMITS)
    if share.regeneration > ESTIMATING_BELOW:
        return bounds
    low = max(mean.regeneration - BOUND_SIGMAS * std.regeneration, LIMITS["eta"].lower)
    low = min(low, 1.0)
    bounds["eta"] = bounds["mu"] = Limits(low, 1.0)
    for name, combination, divisor in (
        ("mass", "mass_over_eta", 1.0),
        ("c_d", "drag_area_over_eta", source.frontal_area),
    ):
        if getattr(share, combination) <= ESTIMATING_BELOW:
            spread = BOUND_SIGMAS * getattr(std, combination)
            middle = getattr(mean, combination)
            ends = np.array((low * (middle - spread), middle + spread)) / divisor
            bounds[name] = Limits(*(float(end) for end in np.clip(ends, *LIMITS[name])))
    return bounds


def _state(combined_share: float, own_share: float) -> State:
    if combined_share > ESTIMATING_BELOW or own_share > UNOBSERVABLE_ABOVE:
        return State.UNESTIMATED
    return State.VALID if combined_share < VALID_BELOW else State.ESTIMATING


def _progress(combined_share: float) -> float:
    """Percent of the way from prior to valid, in the logarithm of the variance left."""
    told = math.log(max(combined_share, 1e-12)) / math.log(VALID_BELOW)
    return 100.0 * min(1.0, max(0.0, told))
