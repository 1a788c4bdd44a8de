"""What was consumed since reset: measured, predicted, integrated by the Runge-Kutta network.

The measured integral stays where it is while the battery is silent; the predicted ones go on
from speed alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

from evpinn_ros.energy.quadrature import MAX_GAP, CompensatedSum, EnergyIntegral
from evpinn_ros.energy.rknn import STEP_LIMIT, Rknn
from evpinn_ros.energy.uncertainty import CORRELATION_TIME, CorrelatedError
from evpinn_ros.errors import InputError
from evpinn_ros.signals.readings import NANOSECONDS


class Flow(NamedTuple):
    """Energy since reset, J, its present power, W, and its 1-sigma, J; NaN where unknown."""

    energy: float
    power: float
    sigma: float


@dataclass(frozen=True, slots=True)
class EnergyState:
    """What the meter says at one moment. Drawn energy is positive.

    Attributes:
        stamp_ns: newest stamp pushed, 0 before the first.
        measured: integral of measured power, sigma from the sensor's; power NaN while silent.
        predicted: quadrature of predicted power; for sigma see `energy.uncertainty`.
        rknn: the Runge-Kutta network on the same power; its power is the last step's mean.
        regenerated: as positive J and W; of measured power, and of predicted power for the time
            the battery was silent. Its sigma is that of the net energy it is a part of.
        consumed: net energy by the same rule, J: measured where possible, predicted elsewhere.
            Where they join, one sample may count twice or not at all.
        gaps: steps too long to integrate, of measured and predicted power together.
        dropped: samples dropped (out of order or not finite), of both together.
        unmeasured_s: time since reset without measured power, s.
        measuring: False while the state is `predicting`.
    """

    stamp_ns: int
    measured: Flow
    predicted: Flow
    rknn: Flow
    regenerated: Flow
    consumed: float
    gaps: int
    dropped: int
    unmeasured_s: float
    measuring: bool


class EnergyMeter:
    """Integrates measured and predicted power side by side.

    Time that goes back is dropped and counted sample by sample; whoever knows that a bag started
    over calls `reset`.
    """

    def __init__(
        self,
        rknn: Rknn,
        *,
        max_gap: float = MAX_GAP,
        battery_timeout: float = MAX_GAP,
        correlation_time: float = CORRELATION_TIME,
    ) -> None:
        """A meter at zero.

        Args:
            rknn: the Runge-Kutta network.
            max_gap: longest step of predicted power that is integrated, s.
            battery_timeout: the battery counts as silent when stamps are this much newer than
                its last sample, s. Longer steps of measured power are not integrated.
            correlation_time: of the error of power, s (see `energy.uncertainty`).

        Raises:
            InputError: `max_gap` is beyond what the network is trained for.
        """
        if not 0 < max_gap <= STEP_LIMIT:
            raise InputError(
                f"max_gap = {max_gap:g} s: must be above 0 and at most {STEP_LIMIT:g}"
            )
        self._network = rknn
        self._max_gap, self._timeout, self._tau = max_gap, battery_timeout, correlation_time
        self.reset()

    def reset(self) -> None:
        """Set everything to zero, as if nothing had ever been pushed."""
        self._measured = EnergyIntegral(self._timeout)
        self._predicted = EnergyIntegral(self._max_gap)
        self._rknn, self._rknn_power = CompensatedSum(), math.nan
        self._measured_error = CorrelatedError(self._tau)
        self._predicted_error = CorrelatedError(self._tau)
        self._begin(bridged=(0.0, 0.0), unmeasured_s=0.0)

    def _begin(self, bridged: tuple[float, float], unmeasured_s: float) -> None:
        self._newest_ns = 0
        self._silent_since_ns: int | None = None
        self._bridged, self._unmeasured_s = bridged, unmeasured_s
        self._anchor = self._predicted_parts()

    def push_predicted(self, stamp_ns: int, power: float, sigma: float) -> None:
        """Take one prediction of power and its 1-sigma, W."""
        step = self._predicted.push(stamp_ns, power)
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if self._silent_since_ns is None:
            self._silent_since_ns = stamp_ns
        if step is None:
            return
        energy = float(self._network.step(step.power, step.power_next, step.dt))
        self._rknn.add(energy)
        self._rknn_power = energy / step.dt
        self._predicted_error.push(sigma, step.dt)

    def push_measured(self, stamp_ns: int, power: float, sigma: float = math.nan) -> None:
        """Take one measurement of power and its 1-sigma, W, NaN if unknown."""
        dropped = self._measured.dropped
        step = self._measured.push(stamp_ns, power)
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if self._measured.dropped > dropped:
            return
        if step is None:
            self._bridged = self._bridged_until_now()
            self._unmeasured_s += self._silence(stamp_ns)
        else:
            self._measured_error.push(sigma, step.dt)
        self._silent_since_ns = stamp_ns
        self._anchor = self._predicted_parts()

    @property
    def measuring(self) -> bool:
        """Whether the battery has been heard within its timeout."""
        heard = self._measured.last_stamp_ns is not None
        return heard and self._silence(self._newest_ns) <= self._timeout

    @property
    def state(self) -> EnergyState:
        """The state now."""
        measuring = self.measuring
        measured_power = self._measured.last_power if measuring else math.nan
        power = measured_power if measuring else self._predicted.last_power
        energy, regenerated = self._bridged if measuring else self._bridged_until_now()
        sigma = self._predicted_error.sigma
        return EnergyState(
            stamp_ns=self._newest_ns,
            measured=Flow(self._measured.energy, measured_power, self._measured_error.sigma),
            predicted=Flow(self._predicted.energy, self._predicted.last_power, sigma),
            rknn=Flow(self._rknn.value, self._rknn_power, sigma),
            regenerated=Flow(
                self._measured.regenerated + regenerated,
                power if math.isnan(power) else max(-power, 0.0),
                self._measured_error.sigma if measuring else sigma,
            ),
            consumed=self._measured.energy + energy,
            gaps=self._measured.gaps + self._predicted.gaps,
            dropped=self._measured.dropped + self._predicted.dropped,
            unmeasured_s=self._unmeasured_until_now(),
            measuring=measuring,
        )

    def exported(self) -> dict[str, Any]:
        """Everything `restore` needs, as plain numbers."""
        bridged = self._bridged if self.measuring else self._bridged_until_now()
        return {
            "measured": self._measured.exported(),
            "predicted": self._predicted.exported(),
            "rknn": self._rknn.value,
            "measured_sigma": self._measured_error.sigma,
            "predicted_sigma": self._predicted_error.sigma,
            "bridged_energy": bridged[0],
            "bridged_regenerated": bridged[1],
            "unmeasured_s": self._unmeasured_until_now(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from what `exported` gave; the next sample starts a new step, not a gap.

        Raises:
            InputError: something is missing or not a number; nothing is changed then.
        """
        measured, predicted = EnergyIntegral(self._timeout), EnergyIntegral(self._max_gap)
        measured.restore(_section(saved, "measured"))
        predicted.restore(_section(saved, "predicted"))
        rknn, energy, regenerated, unmeasured_s = (
            _number(saved, name)
            for name in ("rknn", "bridged_energy", "bridged_regenerated", "unmeasured_s")
        )
        sigmas = [_number(saved, f"{name}_sigma", True) for name in ("measured", "predicted")]
        self._measured, self._predicted = measured, predicted
        self._rknn, self._rknn_power = CompensatedSum(rknn), math.nan
        self._measured_error, self._predicted_error = (
            CorrelatedError(self._tau, sigma) for sigma in sigmas
        )
        self._begin((energy, regenerated), unmeasured_s)

    def _predicted_parts(self) -> tuple[float, float]:
        return self._predicted.energy, self._predicted.regenerated

    def _bridged_until_now(self) -> tuple[float, float]:
        """Predicted net and regenerated energy, J, of all silences and since the battery spoke."""
        now = zip(self._bridged, self._predicted_parts(), self._anchor, strict=True)
        energy, regenerated = (total + new - anchor for total, new, anchor in now)
        return energy, regenerated

    def _unmeasured_until_now(self) -> float:
        pending = 0.0 if self.measuring else self._silence(self._newest_ns)
        return self._unmeasured_s + pending

    def _silence(self, stamp_ns: int) -> float:
        """Time from the last word of the battery (or the first stamp) to this stamp, s."""
        since = self._silent_since_ns
        return 0.0 if since is None else max(stamp_ns - since, 0) / NANOSECONDS


def _section(saved: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = saved.get(name)
    if not isinstance(section, Mapping):
        raise InputError(f"saved energy: '{name}' is missing")
    return section


def _number(saved: Mapping[str, Any], name: str, may_be_nan: bool = False) -> float:
    value = saved.get(name)
    if not isinstance(value, (int, float)):
        raise InputError(f"saved energy: '{name}' is {value!r}, expected a number")
    if not math.isfinite(value) and not (may_be_nan and math.isnan(value)):
        raise InputError(f"saved energy: '{name}' is {value!r}")
    return float(value)
