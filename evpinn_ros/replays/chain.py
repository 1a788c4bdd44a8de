"""The chain of cores: readings to power, parameters and energy, as the three nodes do it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
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
    def dropped(self) -> Counter[str]:
        """Readings of this drive that were refused or did not pass the guard of time."""
        guard = self._guard.dropped + Counter(stamp_leaps=self._guard.held)
        return guard + self.account.refused

    def add_reading(self, reading: Reading) -> Iterator[ChainOutput]:
        """Take one reading; give all that the estimator and then the account say of it."""
        return chain.from_iterable(self.take(list(self.follow(reading))))

    def follow(self, reading: Reading) -> Iterator[Reading | Jump]:
        """Take one reading; give what `take` shall have now: none that is refused or in doubt."""
        for item in self._guard.follow(reading, self._rule):
            if isinstance(item, Jump) or self.account.admission.admits(item):
                yield item

    def take(
        self, block: Sequence[Reading | Jump], *, counted: bool = True
    ) -> Iterator[list[ChainOutput]]:
        """Take readings that may be used, and jumps of time; give the outputs of each item.

        With `counted` the account is among them after each prediction; else `account.count` gives
        its states once the block is over, at a tenth of the time.
        """
        readings: list[Reading] = []
        for item in block:
            if not isinstance(item, Jump):
                readings.append(item)
                continue
            yield from self._read(readings, counted)
            readings = []
            yield self._after_jump()
        yield from self._read(readings, counted)

    def _read(self, readings: Sequence[Reading], counted: bool) -> Iterator[list[ChainOutput]]:
        predicted = self.estimator.add_block(readings)
        for reading in readings:
            self.account.add_reading(reading)
            outputs: list[ChainOutput] = []
            for output in next(predicted):
                outputs.append(output)
                if self._add(output) and counted:
                    self._know_usual()
                    outputs += self.account.count().rows()
                    outputs += filter(None, [self.account.tick()])
            yield outputs
        self._know_usual()

    def _know_usual(self) -> None:
        car = self.estimator.model()
        self.account.usual = math.nan if car is None else usual_cost(car)

    def _add(self, output: Output) -> bool:
        """Tell the account of an output; gives whether that is a prediction that it counts."""
        if not isinstance(output, PowerEstimate):
            return False
        if output.kind is PowerKind.SMOOTHED:
            dropout = output.energy_sigma, output.energy
            power = output.stamp_ns, output.power, output.sigma
            return self.account.add_predicted(*power, *dropout)
        if output.kind is PowerKind.MEASURED:
            self.account.add_measured(output.stamp_ns, output.power, output.sigma)
        return False

    def _after_jump(self) -> list[ChainOutput]:
        if self._rule.policy is not JumpPolicy.RESET:
            self.estimator.handle_time_jump()
            self.account.begin_after_jump()
            return []
        self.estimator.reset()
        if self._start is not None:
            self.estimator.restore(self._start)
        self.account.begin_next_trip()
        return []

    def begin_next_drive(self) -> None:
        """Keep what was learned of the car; time and energy start anew."""
        self.estimator.begin_next_drive()
        self.estimator.clear_counters()
        self._guard, self._start = StampGuard(SpeedReading), self.estimator.export()
        self.account.begin_after_jump()
        self.account.reset_trip()
        self.account.refused.clear()
