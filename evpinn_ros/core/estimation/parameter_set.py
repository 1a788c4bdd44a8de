"""Makes the published set of parameters from their posterior: values, bounds, shares, trust."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.estimation.estimate import ParameterEstimate, ParameterSet, Trust
from evpinn_ros.core.estimation.published import LOGARITHMIC, MU, P_AUX, Published
from evpinn_ros.core.signals.detector import FAR_FROM_PRIOR
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES, POWERS, Identifiable
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES, Limits

ESTIMATING_BELOW = 0.95  # share of the prior's variance left in a combination that is learned
VALID_BELOW = 0.25  # share left in one that the data determine
OWN_VALID_BELOW = 0.5  # share of the parameter's own prior variance; more is mostly prior
UNOBSERVABLE_ABOVE = 0.9  # own share left of a parameter that the data cannot determine
RESTS_ON = {
    "eta": "mass_over_eta",
    "mu": "regeneration",
    "mass": "mass_over_eta",
    "c_rr": "c_rr",
    "c_d": "drag_area_over_eta",
    "p_aux": "p_aux",
}
BOUND_SIGMAS = 2.0
INTERVAL = (0.025, 0.975)  # of the posterior of parameters that cannot exceed 1
STAYS_BELOW = 1.6  # times the limit of a combination's share, up to which a status stays
OWN_STAYS_BELOW = 1.1  # times the limit of the parameter's own share, up to which a status stays
TYRES = Limits(0.004, 0.02)  # C_rr of tyres on roads
# Values of real cars; outside, a parameter is never valid.
POSSIBLE = {"c_rr": TYRES, "c_d": Limits(0.15, 1.0), "eta": Limits(0.0, 0.995)}
MOST_UNSURE = 0.25  # of the value, 1-sigma, beyond which it is never valid
RELIABLE_NEEDS = ("mass_over_eta", "regeneration")
NORMAL = NormalDist()


class _Combined(NamedTuple):
    """A combination: value, 1-sigma, and share of the prior's variance that is left."""

    value: float
    std: float
    share: float


def parameter_set(stamp_ns: int, source: Published) -> ParameterSet:
    """Values, bounds, shares and trust of all parameters and combinations."""
    combined = _combined(source)
    parameters = {}
    for index, name in enumerate(PARAMETER_NAMES):
        variance, before = (float(g.covariance[index, index]) for g in (source.now, source.prior))
        share = min(1.0, variance / before) if before > 0.0 else 1.0
        value, std, limits = _value(name, index, source)
        bounds = _bounds(name, limits, combined, source.frontal_area)
        rests = combined[RESTS_ON[name]].share
        if index == MU and not source.regenerates:
            share, std = 1.0, max(std, value * math.sqrt(before))
        possible = _possible(name, value, hills_seen=source.hills_seen)
        possible = possible and bounds.lower < value < bounds.upper  # else the value is a bound
        possible = possible and (index == P_AUX or std <= MOST_UNSURE * value)  # p_aux may be 0
        parameters[name] = ParameterEstimate(
            value=float(np.clip(value, bounds.lower, bounds.upper)),
            std=min(std, LIMITS[name].upper - LIMITS[name].lower),
            prior_share=share,
            lower=bounds.lower,
            upper=bounds.upper,
            trust=_trust(rests, share, possible=possible),
            progress=_progress(rests),
            possible=possible,
        )
    reliable = all(combined[name].share < VALID_BELOW for name in RELIABLE_NEEDS)
    return ParameterSet(
        stamp_ns,
        parameters,
        Identifiable(*(combined[name].value for name in IDENTIFIABLE_NAMES)),
        Identifiable(*(combined[name].std for name in IDENTIFIABLE_NAMES)),
        reliable,
        {
            name: _trust(combination.share, 0.0, possible=True)
            for name, combination in combined.items()
        },
    )


def deviations(source: Published) -> dict[str, float]:
    """Distance of each parameter from its prior, in prior sigmas."""
    std = np.sqrt(np.diagonal(source.prior.covariance))
    away = (source.now.mean - source.prior.mean) / np.maximum(std, 1e-12)
    return dict(zip(PARAMETER_NAMES, away.tolist(), strict=True))


def identifiable_shares(source: Published) -> Identifiable:
    """Share of the prior's variance that is left in each combination."""
    combined = _combined(source)
    return Identifiable(*(combined[name].share for name in IDENTIFIABLE_NAMES))


class TrustHysteresis:
    """Hysteresis of trust: a status stays until a little beyond the limit where it began."""

    def __init__(self) -> None:
        """Start before any parameter was judged."""
        self._trust: dict[str, Trust] = {}

    def judge(
        self, parameter_set: ParameterSet, away: Mapping[str, float], *, suspected: bool
    ) -> ParameterSet:
        """The set with trust that has hysteresis.

        Args:
            parameter_set: as made by `parameter_set`.
            away: of each parameter from its prior, in prior sigmas.
            suspected: whether the signals contradict each other.
        """
        parameters = {
            name: replace(p, trust=self._next(name, p, away[name], suspected))
            for name, p in parameter_set.parameters.items()
        }
        self._trust = {name: p.trust for name, p in parameters.items()}
        wrong = Trust.INVALID in self._trust.values()
        combined = parameter_set.identifiable_trust
        if suspected:
            combined = dict.fromkeys(combined, Trust.INVALID)
        return replace(
            parameter_set,
            parameters=parameters,
            reliable=parameter_set.reliable and not wrong,
            identifiable_trust=combined,
        )

    def _next(self, name: str, now: ParameterEstimate, away: float, suspected: bool) -> Trust:
        before = self._trust.get(name)
        if suspected or FAR_FROM_PRIOR.judge(before is Trust.INVALID, abs(away)):
            return Trust.INVALID
        stays = now.progress >= _progress(VALID_BELOW * STAYS_BELOW)
        stays = stays and now.prior_share <= OWN_VALID_BELOW * OWN_STAYS_BELOW and now.possible
        if before is Trust.VALID and stays:
            return Trust.VALID
        if now.trust is Trust.UNESTIMATED and before in (Trust.VALID, Trust.ESTIMATING):
            shown = now.progress > 0.0 and now.prior_share <= UNOBSERVABLE_ABOVE * OWN_STAYS_BELOW
            return Trust.ESTIMATING if shown else Trust.UNESTIMATED
        return now.trust


def _combined(source: Published) -> dict[str, _Combined]:
    """Mean, sigma and prior of each combination that the data can determine, by name."""
    combinations = {}
    for name, powers in POWERS.items():
        direction = np.array([powers.get(parameter, 0.0) for parameter in PARAMETER_NAMES])
        mean = float(direction @ source.now.mean)
        variance, before = (
            float(direction @ gaussian.covariance @ direction)
            for gaussian in (source.now, source.prior)
        )
        std = math.sqrt(max(0.0, variance))
        share = variance / before if before > 0.0 else 1.0
        if name == "regeneration" and not source.regenerates:
            share = 1.0  # the equation has no car with the learned value
        if name in ("c_rr", "p_aux"):
            combinations[name] = _Combined(mean, std, share)
        else:
            area = source.frontal_area if name == "drag_area_over_eta" else 1.0
            value = area * math.exp(mean)
            combinations[name] = _Combined(value, value * std, share)
    return combinations


def _value(name: str, index: int, source: Published) -> tuple[float, float, Limits]:
    """Value, 1-sigma and hard limits of a parameter.

    eta and mu cannot exceed 1: theirs is a normal distribution of the logarithm cut off there,
    and near the bound its interval is more informative than value and sigma.
    """
    mean = float(source.now.mean[index])
    std = math.sqrt(max(0.0, float(source.now.covariance[index, index])))
    if index not in LOGARITHMIC:
        return mean, std, LIMITS[name]
    if name not in ("eta", "mu") or std <= 0.0:
        value = math.exp(mean)
        return value, value * std, LIMITS[name]
    below = max(NORMAL.cdf(-mean / std), 1e-12)  # probability of less than 1
    low, middle, high = (
        math.exp(min(0.0, mean + std * NORMAL.inv_cdf(share * below)))
        for share in (INTERVAL[0], 0.5, INTERVAL[1])
    )
    spread = (high - low) / (NORMAL.inv_cdf(INTERVAL[1]) - NORMAL.inv_cdf(INTERVAL[0]))
    return middle, spread, _within((low, high), LIMITS[name])


def _bounds(name: str, limits: Limits, combined: Mapping[str, _Combined], area: float) -> Limits:
    """Bounds that need no prior of an absolute value: eta <= 1 and mu <= 1 bound the rest.

    With q = eta mu known, eta and mu lie in [q, 1], hence mass in [q, 1] m/eta, and C_d in the
    same way; each combination is widened by `BOUND_SIGMAS`. Until the data determine a
    combination, the limits of the parameter stand.
    """
    regeneration = combined["regeneration"]
    if name in ("c_rr", "p_aux") or regeneration.share > ESTIMATING_BELOW:
        return limits
    low = regeneration.value - BOUND_SIGMAS * regeneration.std
    low = min(max(low, LIMITS["eta"].lower), 1.0)
    if name in ("eta", "mu"):
        return Limits(min(max(low, limits.lower), limits.upper), limits.upper)
    whole = combined[RESTS_ON[name]]
    if whole.share > ESTIMATING_BELOW:
        return limits
    divisor = area if name == "c_d" else 1.0
    spread = BOUND_SIGMAS * whole.std
    ends = low * (whole.value - spread) / divisor, (whole.value + spread) / divisor
    return _within(ends, limits)


def _within(ends: tuple[float, float], limits: Limits) -> Limits:
    return Limits(*(min(max(end, limits.lower), limits.upper) for end in ends))


def _trust(combined_share: float, own_share: float, *, possible: bool) -> Trust:
    if combined_share > ESTIMATING_BELOW or own_share > UNOBSERVABLE_ABOVE:
        return Trust.UNESTIMATED
    valid = combined_share < VALID_BELOW and own_share <= OWN_VALID_BELOW
    return Trust.VALID if valid and possible else Trust.ESTIMATING


def _possible(name: str, value: float, *, hills_seen: bool) -> bool:
    """False for a value that no car has, and for C_rr if unknown climbs look like it."""
    if name == "c_rr" and not hills_seen:
        return False
    limits = POSSIBLE.get(name)
    return limits is None or limits.lower <= value <= limits.upper


def _progress(combined_share: float) -> float:
    """Percent of the way from prior to valid, in the logarithm of the variance left."""
    share = math.log(max(combined_share, 1e-12)) / math.log(VALID_BELOW)
    return 100.0 * min(1.0, max(0.0, share))
