"""Estimates: values that nodes publish and commands print."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
import math
from typing import Annotated, Any

from evpinn_ros.common.saved_fields import Figure, figures
from evpinn_ros.core.estimation.lag import Lag
from evpinn_ros.core.vehicle.identifiable import Identifiable


class Trust(str, Enum):
    """Trustworthiness of a parameter.

    `unestimated` while the data hold next to no information on it; `estimating` while it is being
    learned, or mostly prior; `valid` when the data determine it and the value is possible;
    `stale` after a long battery dropout; `invalid` when signals contradict each other, or the
    value is impossible for a car of this model.
    """

    UNESTIMATED = "unestimated"
    ESTIMATING = "estimating"
    VALID = "valid"
    STALE = "stale"
    INVALID = "invalid"


TRACKED = ("value", "std", "prior_share")  # the figures that are recorded over time


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter now: `FIGURES`, in the unit of `vehicle.parameters.Parameters`.

    Attributes:
        trust: how far to trust it.
        progress: percent of the way to a combination that the data determine.
        possible: False if the value cannot be `valid`: no car has it, or it needs heights that are
            unknown.
    """

    value: Annotated[float, Figure("", "live value at the end: 1, 1, kg, 1, 1, W")]
    std: Annotated[float, Figure("", "its 1-sigma")]
    prior_share: Annotated[float, Figure("", "share of the prior in it: 0 all data, 1 all prior")]
    lower: Annotated[
        float,
        Figure("", "bound from the combinations and eta, mu <= 1; while unknown, its limit"),
    ]
    upper: Annotated[float, Figure("", "bound as `lower`")]
    trust: Trust
    progress: float = 0.0
    possible: bool = True

    @property
    def state(self) -> str:
        """Its trust as text."""
        return self.trust.value

    def figures(self) -> dict[str, Any]:
        """Its numbers by the names of `FIGURES`."""
        return {name: getattr(self, name) for name in FIGURES}


FIGURES = figures(ParameterEstimate) | {
    "state": Figure("", f"{', '.join(f'`{trust.value}`' for trust in [*Trust][:-1])} or `invalid`")
}
"""Figures of a parameter in files, tables and frames."""


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """All parameters at one moment.

    Attributes:
        stamp_ns: stamp of the newest sample they rest on.
        parameters: one estimate for each of `PARAMETER_NAMES`.
        identifiable: combinations that the data alone determine.
        identifiable_std: their 1-sigma.
        reliable: whether every validity check is passed.
        identifiable_trust: how far each combination can be trusted.
        lag: time by which speed is stamped later than the battery, None while unknown.
    """

    stamp_ns: int
    parameters: Mapping[str, ParameterEstimate]
    identifiable: Identifiable
    identifiable_std: Identifiable
    reliable: bool
    identifiable_trust: Mapping[str, Trust] = field(default_factory=dict)
    lag: Lag | None = None

    def stale(self) -> ParameterSet:
        """The parameters with `stale` in place of `valid`, after a long dropout."""
        return self._faded(Trust.STALE)

    def doubted(self) -> ParameterSet:
        """The parameters with none `valid`, because signals of different moments were joined."""
        return self._faded(Trust.ESTIMATING)

    def _faded(self, trust: Trust) -> ParameterSet:
        """The parameters with this trust in place of `valid`."""
        fades = {Trust.VALID: trust}
        return replace(
            self,
            parameters={
                name: replace(p, trust=fades.get(p.trust, p.trust))
                for name, p in self.parameters.items()
            },
            reliable=False,
            identifiable_trust={
                name: fades.get(trust, trust) for name, trust in self.identifiable_trust.items()
            },
        )


class PowerKind(str, Enum):
    """Power topic that a value belongs to."""

    MEASURED = "measured"
    PREDICTED = "predicted"
    SMOOTHED = "smoothed"


@dataclass(frozen=True, slots=True)
class PowerEstimate:
    """Battery power at one moment.

    Attributes:
        kind: topic.
        stamp_ns: the moment.
        power: W.
        sigma: its 1-sigma, W.
        energy: predicted since the battery was last measured, J; NaN while it is measured.
        energy_sigma: its 1-sigma, J; NaN where it is not known.
    """

    kind: PowerKind
    stamp_ns: int
    power: float
    sigma: float
    energy: float = math.nan
    energy_sigma: float = math.nan
