"""Model of the battery: charge, and a voltage that falls with charge and with current.

The charge that a kilowatt-hour takes varies: a full battery has a higher voltage than an empty
one, and its resistance costs more at higher power. The capacity in ampere hours does not vary
(61.2 to 62.7 Ah on eleven trips of an i3, whose energy per percent differs by 11 %). So the charge
along a plan follows

    dq/dt = -I / Q,    P = V I,    V = U(q) - R I

in closed form, because U is a straight line in q. A Kalman filter learns U and R from voltage,
current and state of charge; Q is learned like a capacity in energy (`energy.charge`). A
polarisation behind a second resistance did not improve the charge at the end of a plan.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.energy.charge import UNKNOWN, ChargeGauge, SavedGauge, Uncertain
from evpinn_ros.core.energy.forecast import EMPTY, Forecast
from evpinn_ros.core.energy.quadrature import MAX_GAP, EnergyIntegral
from evpinn_ros.core.signals.readings import MAX_CURRENT, MAX_VOLTAGE, MIN_VOLTAGE, NANOSECONDS

LEARN_EVERY = 1.0  # s
# 1-sigma of one voltage, V: an error of 1.5 V that lasts for a minute.
NOISE = 10.0
LEAST_SAMPLES = 60  # from which on the model is used
LEVEL_TIME = 20.0  # s over which the error of the voltage is averaged
# 1-sigma before any reading, and drift in an hour (temperature), as shares: of U at half charge
# and of its slope, over that U; of R, over its prior.
PRIOR_SHARE = np.array([0.08, 0.1, 1.0])
DRIFT_SHARE = np.array([0.01, 0.005, 0.1])
SLOPE_SHARE = 0.15  # of U, from empty to full: typical of lithium-ion cells
RESISTANCE_SHARE = 0.013  # of U / (current that empties the battery in an hour), typical too
USUAL_CHARGE = 3600 * 100.0  # A s, where the vehicle file has no capacity
CHARGE_LIMITS = (3600.0, 3.6e7)  # A s
MOST_SAVED, MOST_SAMPLES = 1e6, 1e15


class BatteryEnd(NamedTuple):
    """The battery at the end of a plan: state of charge, 0..1, and terminal voltage, V or NaN."""

    charge: Uncertain
    voltage: float


@dataclass(frozen=True, slots=True)
class SavedBattery:
    """Samples, U at half charge, its slope and R, their covariance row by row, and the gauge."""

    samples: Annotated[int, Range(0, MOST_SAMPLES)]
    state: Annotated[np.ndarray, Range(-MOST_SAVED, MOST_SAVED, shape=(3,))]
    covariance: Annotated[np.ndarray, Range(-MOST_SAVED, MOST_SAVED, shape=(9,))]
    full_charge: SavedGauge

    def __post_init__(self) -> None:
        """Refuse a state that no battery has."""
        square = self.covariance.reshape(3, 3)
        if self.samples and not (
            MIN_VOLTAGE <= self.state[0] <= MAX_VOLTAGE
            and np.allclose(square, square.T)
            and float(np.linalg.eigvalsh(square)[0]) > 0
        ):
            raise ValueError("a number is out of range")


class BatteryModel(Saveable[SavedBattery]):
    """Learns one battery from its voltage, current and state of charge.

    Attributes:
        samples: number of samples learned from, one each `LEARN_EVERY`.
    """

    def __init__(self, capacity: float) -> None:
        """Start without a reading; `capacity` of the vehicle file, J, NaN if unknown."""
        self._capacity = capacity
        self.reset()

    def reset(self) -> None:
        """Forget what was learned of the cells, and the capacity."""
        self.samples = 0
        self._state = np.zeros(3)  # U at half charge, dU/dq, V; R, Ohm
        self._covariance = np.zeros((3, 3))
        self._gauge = ChargeGauge(math.nan, CHARGE_LIMITS)
        self.begin_anew()

    def begin_anew(self) -> None:
        """Join nothing to earlier readings: time jumped."""
        self._current = EnergyIntegral(MAX_GAP)
        self._gauge.begin_anew()
        self._charge, self._level = math.nan, 0.0
        self._learned_ns = 0

    @property
    def known(self) -> bool:
        """True if enough was learned to forecast with."""
        return self.samples >= LEAST_SAMPLES and self._gauge.capacity.known

    def extend(
        self, stamps: np.ndarray, voltage: np.ndarray, current: np.ndarray, charge: np.ndarray
    ) -> None:
        """Take readings, shape (n,) each, as in `BatteryReading`; impossible ones are ignored."""
        within = (charge >= 0.0) & (charge <= 1.0)
        charge = np.append(self._charge, np.where(within, charge, math.nan))
        last = np.maximum.accumulate(np.where(np.isnan(charge), 0, np.arange(len(charge))))
        charge = charge[last]
        self._charge = float(charge[-1])
        possible = (voltage >= MIN_VOLTAGE) & (voltage <= MAX_VOLTAGE)
        possible &= np.abs(current) <= MAX_CURRENT
        course = self._current.extend(stamps[possible], -current[possible])
        kept = np.flatnonzero(possible)[course.places]
        taken = (course.drawn - course.regenerated)[1:]
        rows = zip(
            course.stamps.tolist(),
            voltage[kept].tolist(),
            (-current[kept]).tolist(),
            charge[kept + 1].tolist(),
            taken.tolist(),
            course.gaps[1:].tolist(),
            strict=True,
        )
        for stamp_ns, volts, amperes, level, energy, gaps in rows:
            due = stamp_ns - self._learned_ns >= LEARN_EVERY * NANOSECONDS
            if math.isnan(level) or not (due or self._gauge.is_new(level, gaps)):
                continue
            if not self.samples:
                self._begin(volts)
            self._gauge.update(stamp_ns, level, Uncertain(energy, 0.0), gaps)
            if due:
                self._learn(stamp_ns, volts, amperes, level)

    def _begin(self, voltage: float) -> None:
        """Take the priors, which scale with the first voltage."""
        self._gauge = ChargeGauge(self._capacity / voltage, CHARGE_LIMITS)
        scale = self._scale(voltage)
        self._state = np.array([1.0, SLOPE_SHARE, 1.0]) * scale
        self._covariance = np.diag((scale * PRIOR_SHARE) ** 2)

    def _scale(self, voltage: float) -> np.ndarray:
        """Scales of `PRIOR_SHARE` and `DRIFT_SHARE`: U, V, twice, and the prior of R, Ohm."""
        full = self._capacity / voltage
        hour = (USUAL_CHARGE if math.isnan(full) else full) / 3600
        return np.array([voltage, voltage, RESISTANCE_SHARE * voltage / hour])

    def _learn(self, stamp_ns: int, voltage: float, current: float, charge: float) -> None:
        """A Kalman update by one voltage, V, at a current, A, and a state of charge."""
        elapsed = (stamp_ns - self._learned_ns) / NANOSECONDS
        elapsed = LEARN_EVERY if elapsed > MAX_GAP else elapsed
        scale = self._scale(float(self._state[0]))
        self._covariance += np.diag((scale * DRIFT_SHARE) ** 2 * elapsed / 3600)
        excess = np.sqrt(np.diag(self._covariance)) / (scale * PRIOR_SHARE)
        narrow = 1 / np.maximum(excess, 1.0)  # sigma never exceeds that of the prior
        self._covariance *= np.outer(narrow, narrow)
        row = np.array([1.0, charge - 0.5, -current])
        error = voltage - float(row @ self._state)
        towards = self._covariance @ row
        gain = towards / (float(row @ towards) + NOISE**2)
        self._state = self._state + gain * error
        self._covariance = self._covariance - np.outer(gain, towards)
        self._level += (voltage - float(row @ self._state) - self._level) * elapsed / LEVEL_TIME
        self.samples += 1
        self._learned_ns = stamp_ns

    def after(self, result: Forecast, charge: Uncertain, capacity: Uncertain) -> BatteryEnd:
        """The battery at the end of one plan; charge 0 if it is empty before.

        Args:
            result: forecast of a single plan, shape (n,).
            charge: now, 0..1.
            capacity: energy of the full battery, J.
        """
        left, sigma = self.along(result, charge, capacity)[:, -1].tolist()
        if not math.isfinite(left + sigma):
            return BatteryEnd(UNKNOWN, math.nan)
        end, voltage = Uncertain(max(left, 0.0), sigma), math.nan
        if self.known:
            drawn = self._drawn(float(result.power[-1]), left)
            voltage = self._open_voltage(left) - self._resistance() * drawn
        return BatteryEnd(end, voltage)

    def along(self, result: Forecast, charge: Uncertain, capacity: Uncertain) -> np.ndarray:
        """State of charge at each point of one plan and its 1-sigma, shape (2, n).

        Energy over capacity while the model is not `known`. NaN where unknown; 0 or less from the
        point where the battery is empty, even if a descent follows. A full battery takes nothing
        back.
        """
        if charge.known and self.known:
            full = self._gauge.capacity
            left = self._left(result, charge.value)
            by_energy = result.sigma / (full.value * np.maximum(self._line(left), MIN_VOLTAGE))
        else:
            full = capacity
            left = charge.value - result.energy / full.value
            by_energy = result.sigma / full.value
        lost = (charge.value - left) * full.sigma / full.value
        left = left - np.maximum(np.maximum.accumulate(left) - 1.0, 0.0)
        left = np.where(np.maximum.accumulate(left <= EMPTY), np.minimum(left, 0.0), left)
        return np.stack([left, np.sqrt(charge.sigma**2 + by_energy**2 + lost**2)])

    def _left(self, result: Forecast, charge: float) -> np.ndarray:
        """State of charge at each point of a plan, shape (n,), `charge` at its begin.

        While the charge falls by d the cells give Q (U d - slope d^2 / 2), of which R takes R I^2
        with the mean power between two points.
        """
        steps, energy = np.diff(result.time), np.diff(result.energy)
        volts, slope = self._open_voltage(charge), float(self._state[1])
        heat = self._resistance() * energy**2 / np.maximum(steps, 1e-9) / volts**2
        taken = np.append(0.0, np.cumsum(energy + heat)) / self._gauge.capacity.value
        root = np.sqrt(np.maximum(volts**2 - 2.0 * slope * taken, 0.0))
        return np.asarray(charge - 2.0 * taken / (volts + root))

    def _open_voltage(self, charge: float) -> float:
        return max(float(self._line(charge)), MIN_VOLTAGE)

    def _line(self, charge: Any) -> Any:
        """U at states of charge, V: the straight line plus its present error."""
        base, slope = self._state[:2].tolist()
        return base + slope * (charge - 0.5) + self._level

    def _resistance(self) -> float:
        return max(float(self._state[2]), 0.0)

    def _drawn(self, power: float, charge: float) -> float:
        """Current at a power, W, A; beyond the largest possible power, that of this."""
        voltage = self._open_voltage(charge)
        root = math.sqrt(max(voltage**2 - 4 * self._resistance() * power, 0.0))
        return 2 * power / (voltage + root)  # the stable form, also for R = 0

    def saved(self) -> SavedBattery:
        """Mean and covariance of the model, and the gauge."""
        covariance = self._covariance.ravel()
        return SavedBattery(self.samples, self._state, covariance, self._gauge.saved())

    def take(self, saved: SavedBattery) -> None:
        """Go on from what was learned."""
        first = saved.state[0] if saved.samples else 1.0
        gauge = ChargeGauge(self._capacity / first, CHARGE_LIMITS)
        gauge.take(saved.full_charge)
        self.samples, self._state = saved.samples, saved.state
        self._covariance = saved.covariance.reshape(3, 3).copy()
        self._gauge = gauge
        self.begin_anew()
