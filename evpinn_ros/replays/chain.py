"""The chain of cores: readings to power, parameters and energy, as the three nodes do it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
import math
from typing import Any, TypeAlias

from evpinn_ros.core.energy.account import AccountSummary, EnergyAccount
from evpinn_ros.core.energy.meter import EnergyMeter, EnergyState
from evpinn_ros.core.energy.remaining import usual_cost
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator, Output
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.admission import CarLimits
from evpinn_ros.core.signals.readings import Reading, SpeedReading
from evpinn_ros.core.signals.time_jump import (
    DEFAULT_RULE,
    Jump,
    JumpPolicy,
    JumpRule,
    StampGuard,
)
from evpinn_ros.core.vehicle.files import Vehicle

ChainOutput: TypeAlias = Output | EnergyState | AccountSummary


class Chain:
    """Estimator and energy account, the one behind the other."""

    def __init__(
        self,
        vehicle: Vehicle,
        settings: EstimatorSettings,
        worker: InlineWorker,
        rule: JumpRule = DEFAULT_RULE,
    ) -> None:
        """Start at the vehicle's priors and at zero energy.

        Args:
            vehicle: the car.
            settings: of the estimator.
            worker: computes its updates.
            rule: for time that jumps.
        """
        self.estimator = OnlineEstimator(vehicle, settings, worker)
        self._rule, self._guard = rule, StampGuard(SpeedReading)
        self._start: Mapping[str, Any] | None = None  # what was known when the drive began
        self.account = EnergyAccount(
            EnergyMeter(load_rknn()),
            vehicle.key,
            vehicle.battery_capacity,
            CarLimits.of(vehicle),
        )

    @property
    def meter(self) -> EnergyMeter:
        """Meter of the account."""
        return self.account.meter

    @property
    def dropped(self) -> Counter[str]:
        """Readings of this drive that were refused or did not pass the guard of time."""
        guard = self._guard.dropped + Counter(stamp_leaps=self._guard.held)
        return guard + self.account.refused

    def add_reading(self, reading: Reading) -> Iterator[ChainOutput]:
        """Take one reading; give all that the estimator and then the account say of it."""
        for item in self.follow(reading):
            yield from self.take(item)

    def follow(self, reading: Reading) -> Iterator[Reading | Jump]:
        """Take one reading; give what `take` shall have now: none that is refused or in doubt."""
        for item in self._guard.follow(reading, self._rule):
            if isinstance(item, Jump) or self.account.admission.admits(item):
                yield item

    def take(self, reading: Reading | Jump) -> Iterator[ChainOutput]:
        """Take a reading that may be used, or a jump of time."""
        if isinstance(reading, Jump):
            self._jump()
            return
        self.account.add_reading(reading)
        for output in self.estimator.add_reading(reading):
            yield output
            if not isinstance(output, PowerEstimate):
                continue
            if output.kind is PowerKind.SMOOTHED:
                self.account.add_predicted(
                    output.stamp_ns,
                    output.power,
                    output.sigma,
                    output.energy_sigma,
                    output.energy,
                )
                car = self.estimator.model()
                self.account.usual = math.nan if car is None else usual_cost(car)
                yield self.account.state
                summary = self.account.tick()
                if summary is not None:
                    yield summary
            elif output.kind is PowerKind.MEASURED:
                self.account.add_measured(output.stamp_ns, output.power, output.sigma)

    def _jump(self) -> None:
        if self._rule.policy is not JumpPolicy.RESET:
            self.estimator.handle_time_jump()
            self.account.begin_after_jump()
            return
        self.estimator.reset()
        if self._start is not None:
            self.estimator.restore(self._start)
        self.account.begin_next_trip()

    def begin_next_drive(self) -> None:
        """Keep what was learned of the car; time and energy start anew."""
        self.estimator.begin_next_drive()
        self.estimator.clear_counters()
        self._guard, self._start = StampGuard(SpeedReading), self.estimator.export()
        self.account.begin_after_jump()
        self.account.reset_trip()
        self.account.refused.clear()
