"""Energy consumed since reset: measured, predicted, integrated by the Runge-Kutta network.

The measured integral stays where it is during a battery dropout; the predicted ones go on from
speed alone, and bridge it. Between two samples of a slow battery the prediction shapes the power
(`energy.power_interpolation`). When speed drops out as well, nothing is known of what was taken:
that time is counted, and no line is drawn across it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum
import math
from typing import NamedTuple

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.saved_fields import Saveable
from evpinn_ros.core.energy.dropout import Bridge, Dropout, Dropouts
from evpinn_ros.core.energy.plausible import ROUNDING, Joules, Seconds, Sigma
from evpinn_ros.core.energy.power_interpolation import (
    LONGEST,
    MeasuredStep,
    PowerInterpolation,
)
from evpinn_ros.core.energy.quadrature import MAX_GAP, EnergyIntegral, SavedIntegral, Step
from evpinn_ros.core.energy.rknn import STEP_LIMIT, Rknn
from evpinn_ros.core.energy.uncertainty import LASTING_SHARE, CorrelatedError
from evpinn_ros.core.signals.admission import MAX_POWER
from evpinn_ros.core.signals.readings import NANOSECONDS


class Integrator(str, Enum):
    """Integrator of the predicted power that stands in for the battery."""

    RKNN = "rknn"
    TRAPEZOID = "trapezoid"


class Flow(NamedTuple):
    """Energy since reset, J, its present power, W, and its 1-sigma, J; NaN where unknown."""

    energy: float
    power: float
    sigma: float


@dataclass(frozen=True, slots=True)
class EnergyState:
    """State of the meter at one moment. Drawn energy is positive.

    Attributes:
        stamp_ns: newest stamp counted, 0 before the first.
        measured: integral of measured power, sigma from the sensor's; power NaN while silent.
        predicted: quadrature of predicted power; for sigma see `energy.uncertainty`. The part of
            it that lasts is counted for the time the battery was silent.
        rknn: the Runge-Kutta network on the same power; its power is the last step's mean.
        regenerated: as positive J and W; of measured power, and of predicted power for the time
            the battery was silent. Its sigma is that of the net energy it is a part of.
        consumed: net energy by the same rule, J: measured where possible, predicted elsewhere.
            Where they join, one sample may count twice or not at all. A step of a slow battery
            counts as a straight line until the prediction, which lags behind, has passed it.
        consumed_sigma: its 1-sigma, J.
        gaps: steps too long to integrate, of measured and predicted power together.
        dropped: samples dropped (out of order or not finite), of both together.
        unmeasured_s: time since reset without measured power, s.
        unknown_s: the part of it without predicted power either, s: energy that was not counted.
        measuring: False while the state is `predicting`.
    """

    stamp_ns: int
    measured: Flow
    predicted: Flow
    rknn: Flow
    regenerated: Flow
    consumed: float
    consumed_sigma: float
    gaps: int
    dropped: int
    unmeasured_s: float
    unknown_s: float
    measuring: bool


@dataclass(frozen=True, slots=True)
class SavedMeter:
    """Integrals of a meter, their 1-sigma, J, and what `Dropouts` holds; see `EnergyState`."""

    measured: SavedIntegral = field(default_factory=SavedIntegral)
    predicted: SavedIntegral = field(default_factory=SavedIntegral)
    rknn: Joules = 0.0
    measured_sigma: Sigma = 0.0
    predicted_sigma: Sigma = 0.0
    bridged: Bridge = field(default_factory=Bridge)
    bridged_sigma: Sigma = 0.0
    lasting_sigma: Sigma = 0.0
    unmeasured_s: Seconds = 0.0

    def __post_init__(self) -> None:
        """Refuse what no car can have drawn in that time."""
        self.measured.refuse_above(MAX_POWER)
        self.predicted.refuse_above(MAX_POWER)
        if abs(self.rknn) > MAX_POWER * self.predicted.covered_s * ROUNDING:
            raise ValueError(f"rknn is more than {MAX_POWER:g} W all the time")


class EnergyMeter(Saveable[SavedMeter]):
    """Integrates measured and predicted power side by side.

    Time that goes back is dropped and counted sample by sample; whoever knows that a bag started
    over calls `reset`.

    Attributes:
        last_dropout: the last dropout that ended, None before.
    """

    def __init__(
        self,
        rknn: Rknn,
        *,
        integrator: Integrator = Integrator.RKNN,
        max_gap: float = MAX_GAP,
    ) -> None:
        """A meter at zero.

        Args:
            rknn: the Runge-Kutta network.
            integrator: of predicted power where it stands in for the battery, in a dropout
                and between two slow samples; both integrals of it are in the state.
            max_gap: longest step of predicted power that is integrated, s.

        Raises:
            InputError: `max_gap` is beyond what the network is trained for.
        """
        if not 0 < max_gap <= STEP_LIMIT:
            raise InputError(
                f"max_gap = {max_gap:g} s: must be above 0 and at most {STEP_LIMIT:g}"
            )
        self._network, self._integrator = rknn, integrator
        self._max_gap = max_gap
        self.reset()

    def reset(self) -> None:
        """Set everything to zero, as if nothing had ever been counted."""
        self.take(SavedMeter())

    def take(self, saved: SavedMeter) -> None:
        """Go on from what was counted; the next sample starts a new step, not a gap."""
        self._measured = EnergyIntegral(MAX_GAP, saved.measured)
        self._predicted = EnergyIntegral(self._max_gap, saved.predicted)
        self._rknn, self._rknn_power = saved.rknn, math.nan
        self._measured_error = CorrelatedError(saved.measured_sigma)
        self._predicted_error = CorrelatedError(saved.predicted_sigma)
        self._newest_ns = 0
        self._dropout_since_ns: int | None = None
        self.last_dropout: Dropout | None = None
        # Those that ended, and what the course of power added.
        variances = saved.bridged_sigma**2, saved.lasting_sigma**2
        self._dropouts = Dropouts(saved.bridged, *variances, saved.unmeasured_s)
        by_network = self._integrator is Integrator.RKNN
        self._interpolation = PowerInterpolation(
            self._max_gap, self._network if by_network else None
        )
        self._dropout_error = CorrelatedError()
        self._energy = self._energy_sigma = math.nan
        self._anchor = self._predicted_parts()

    def add_predicted(
        self,
        stamp_ns: int,
        power: float,
        sigma: float,
        energy_sigma: float = math.nan,
        energy: float = math.nan,
    ) -> None:
        """Take one prediction of power.

        Args:
            stamp_ns: its moment.
            power: W.
            sigma: its 1-sigma, W.
            energy_sigma: 1-sigma of the energy predicted since the battery was last measured, J,
                where the estimator knows it; NaN where it is to be guessed from `sigma`.
            energy: that energy, J; NaN where it is the integral of `power`.
        """
        self._energy, self._energy_sigma = energy, energy_sigma
        dropped = self._predicted.dropped
        step = self._predicted.append(stamp_ns, power)
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if self._dropout_since_ns is None:
            self._dropout_since_ns = stamp_ns
        if self._predicted.dropped == dropped:
            self._correct(self._interpolation.add_predicted(stamp_ns, power, sigma))
        if step is None:
            return
        energy = float(self._network.step(step.power, step.power_next, step.dt))
        self._rknn += energy
        self._rknn_power = energy / step.dt
        self._predicted_error.integrate(sigma, step.dt)
        self._dropout_error.integrate(sigma, step.dt)

    def add_measured(self, stamp_ns: int, power: float, sigma: float = math.nan) -> None:
        """Take one measurement of power and its 1-sigma, W, NaN if unknown."""
        dropped, last_ns = self._measured.dropped, self._measured.last_stamp_ns
        last_power = self._measured.last_power
        step = self._measured.append(stamp_ns, power)
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if self._measured.dropped > dropped:
            return
        if last_ns is None:
            self._end_dropout(stamp_ns)
        elif step is None:
            ended = self._end_dropout(stamp_ns)
            line = Step((stamp_ns - last_ns) / NANOSECONDS, last_power, power)
            if line.dt <= LONGEST:
                dropout = MeasuredStep(last_ns, stamp_ns, line, ended.bridge)
                self._correct(self._interpolation.add_measured(dropout))
        else:
            self._measured_error.integrate(sigma, step.dt)
            self._correct(self._interpolation.add_measured(MeasuredStep(last_ns, stamp_ns, step)))
        self._dropout_since_ns = stamp_ns
        self._dropout_error = CorrelatedError()
        self._anchor = self._predicted_parts()

    def _correct(self, corrections: Iterable[tuple[Bridge, float]]) -> None:
        for bridge, variance in corrections:
            self._dropouts = self._dropouts.corrected(bridge, variance)

    def _end_dropout(self, stamp_ns: int) -> Dropout:
        ended = self._dropout_until(stamp_ns)
        self._dropouts = self._dropouts.after(ended)
        if ended.duration > self._measured.longest_step:
            self.last_dropout = ended
        return ended

    def _dropout_until(self, stamp_ns: int) -> Dropout:
        """The dropout since the last sample of the battery, as if it ended at this stamp."""
        bridge = self._predicted_parts().less(self._anchor)
        if math.isfinite(self._energy):
            bridge = bridge._replace(energy=self._energy)
        if math.isfinite(self._energy_sigma):
            short = sigma = self._energy_sigma
        else:
            short = self._dropout_error.sigma
            sigma = math.hypot(short, LASTING_SHARE * bridge.gross)
        return Dropout(stamp_ns, self._dropout_seconds(stamp_ns), bridge, short, sigma)

    def in_dropout(self, stamp_ns: int) -> bool:
        """True if the battery gave nothing within its timeout before this stamp."""
        measured = self._measured.last_stamp_ns is not None
        return not measured or self._dropout_seconds(stamp_ns) > self._measured.longest_step

    @property
    def measuring(self) -> bool:
        """True if the battery was measured within its timeout."""
        return not self.in_dropout(self._newest_ns)

    @property
    def consumed(self) -> float:
        """Net energy, J, of the state, which takes longer to make."""
        return self._measured.energy + self._until_now().bridged.energy

    @property
    def state(self) -> EnergyState:
        """The state now."""
        measuring, now = self.measuring, self._until_now()
        measured_power = self._measured.last_power if measuring else math.nan
        power = measured_power if measuring else self._predicted.last_power
        consumed_sigma = math.hypot(self._measured_error.sigma, math.sqrt(now.variance))
        sigma = math.hypot(self._predicted_error.sigma, math.sqrt(now.lasting_variance))
        return EnergyState(
            stamp_ns=self._newest_ns,
            measured=Flow(self._measured.energy, measured_power, self._measured_error.sigma),
            predicted=Flow(self._predicted.energy, self._predicted.last_power, sigma),
            rknn=Flow(self._rknn, self._rknn_power, sigma),
            regenerated=Flow(
                self._measured.regenerated + now.bridged.regenerated,
                power if math.isnan(power) else max(-power, 0.0),
                consumed_sigma,
            ),
            consumed=self._measured.energy + now.bridged.energy,
            consumed_sigma=consumed_sigma,
            gaps=self._measured.gaps + self._predicted.gaps,
            dropped=self._measured.dropped + self._predicted.dropped,
            unmeasured_s=now.seconds,
            unknown_s=max(now.seconds - now.bridged.covered_s, 0.0),
            measuring=measuring,
        )

    def saved(self) -> SavedMeter:
        """State to save, the present dropout counted in it."""
        now = self._until_now()
        return SavedMeter(
            measured=self._measured.saved(),
            predicted=self._predicted.saved(),
            rknn=self._rknn,
            measured_sigma=self._measured_error.sigma,
            predicted_sigma=self._predicted_error.sigma,
            bridged=now.bridged,
            bridged_sigma=math.sqrt(now.variance),
            lasting_sigma=math.sqrt(now.lasting_variance),
            unmeasured_s=now.seconds,
        )

    def _until_now(self) -> Dropouts:
        """All dropouts, the present one among them."""
        if self.measuring:
            return self._dropouts
        return self._dropouts.after(self._dropout_until(self._newest_ns))

    def _predicted_parts(self) -> Bridge:
        whole = self._predicted
        energy = self._rknn if self._integrator is Integrator.RKNN else whole.energy
        return Bridge(energy, whole.regenerated, whole.drawn + whole.regenerated, whole.covered_s)

    def _dropout_seconds(self, stamp_ns: int) -> float:
        """Time from the last word of the battery (or the first stamp) to this stamp, s."""
        since = self._dropout_since_ns
        return 0.0 if since is None else max(stamp_ns - since, 0) / NANOSECONDS
