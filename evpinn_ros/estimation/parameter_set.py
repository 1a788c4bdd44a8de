"""From the filter's state to what is published: values, bounds, shares and states."""

from __future__ import annotations

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
        )
    reliable = all(getattr(combined_share, name) < VALID_BELOW for name in RELIABLE_NEEDS)
    return ParameterSet(stamp_ns, parameters, combined, combined_std, reliable)


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
            lower = max(low * (middle - spread) / divisor, LIMITS[name].lower)
            bounds[name] = Limits(lower, (middle + spread) / divisor)
    return bounds


def _state(combined_share: float, own_share: float) -> State:
    if combined_share > ESTIMATING_BELOW or own_share > UNOBSERVABLE_ABOVE:
        return State.UNESTIMATED
    return State.VALID if combined_share < VALID_BELOW else State.ESTIMATING
