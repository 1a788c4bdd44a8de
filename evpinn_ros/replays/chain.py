"""The chain of cores: readings to power, parameters and energy, as the three nodes do it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, groupby
import math
from typing import Any, TypeAlias

import numpy as np

from evpinn_ros.core.energy.account import AccountSummary, EnergyAccount
from evpinn_ros.core.energy.meter import EnergyMeter, EnergyState
from evpinn_ros.core.energy.remaining import usual_cost
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.outputs import Output, Outputs
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.admission import CarLimits
from evpinn_ros.core.signals.block import Block, joined
from evpinn_ros.core.signals.readings import Reading, SpeedReading
from evpinn_ros.core.signals.time_jump import (
    DEFAULT_RULE,
    Jump,
    JumpPolicy,
    JumpRule,
    StampGuard,
)
from evpinn_ros.core.vehicle.files import Vehicle

ChainOutput: TypeAlias = Output | Breakdown | EnergyState | AccountSummary


class Chain:
    """Estimator and energy account, the one behind the other."""

    def __init__(
        self,
        vehicle: Vehicle,
        settings: EstimatorSettings,
        worker: InlineWorker,
        rule: JumpRule = DEFAULT_RULE,
    ) -> None:
        """Start at the vehicle's priors and zero energy; the worker computes updates."""
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
        return self.add_readings([reading])

    def add_readings(self, readings: Iterable[Reading]) -> Iterator[ChainOutput]:
        """Take readings in the order they came; give all that is said of them, in order."""
        return chain.from_iterable(self.take(self.follow(Block.of(readings))))

    def follow(self, block: Block) -> Iterator[Block | Jump]:
        """Take readings; give what `take` shall have now: none that is refused or in doubt."""
        for passed in self._guard.follow(block, self._rule):
            if isinstance(passed, Jump):
                yield passed
            elif len(admitted := self.account.admission.admit(passed)):
                yield admitted

    def take(self, items: Iterable[Block | Jump]) -> Iterator[list[ChainOutput]]:
        """Outputs of each block of readings or jump, with accounts."""
        for _, alike in groupby(items, type):
            blocks = []
            for item in alike:
                if isinstance(item, Block):
                    blocks.append(item)
                else:
                    self.jump()
                    yield []
            yield from self.take_block(joined(blocks))

    def read(self, block: Block) -> Outputs:
        """Take readings that may be used; `account.count` then gives the states of the account."""
        outputs = self.estimator.add_block(block)
        self.account.add_block(block, *_powers(outputs))
        self._know_usual(self.estimator.model())
        return outputs

    def take_block(self, block: Block, *, breakdowns: bool = False) -> Iterator[list[ChainOutput]]:
        """`take` for readings alone, with breakdowns if asked."""
        if not block.length:
            return
        usual = self.estimator.model()
        outputs = self.estimator.add_block(block, breakdowns=breakdowns)
        given: list[list[ChainOutput]] = [[] for _ in range(block.length)]
        for place, output in outputs.by_place():
            given[place].append(output)
        for learned in outputs.learned:
            if learned.breakdown is not None:
                given[learned.place].append(learned.breakdown)
        changes, first = iter((*outputs.learned, None)), 0
        after = next(changes)
        due = self.account.summaries(*_powers(outputs))
        for last in sorted({*due, block.length - 1}):
            while after is not None and after.place < last:
                usual, after = after.model, next(changes)
            self._know_usual(usual)
            part = slice(first, last + 1)
            powers = [_part(columns, part) for columns in _powers(outputs)]
            counted = self.account.add_block(block.part(first, last + 1), *powers)
            for place, state in zip(counted.tolist(), self.account.count().rows(), strict=True):
                given[first + place].append(state)
            if last in due and (summary := self.account.tick()) is not None:
                given[last].append(summary)
            first = last + 1
        self._know_usual(self.estimator.model())
        yield from given

    def _know_usual(self, car: CarModel | None) -> None:
        self.account.usual = math.nan if car is None else usual_cost(car)

    def jump(self) -> None:
        """Time jumped back: join nothing across it, and begin anew where the rule says so."""
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


def _powers(outputs: Outputs) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Measured and smoothed powers as `EnergyAccount.add_block` takes them."""
    smoothed = outputs.smoothed
    return outputs.measured[:4], (*smoothed[:4], smoothed.energy_sigma, smoothed.energy)


def _part(columns: Sequence[np.ndarray], places: slice) -> tuple[np.ndarray, ...]:
    chosen = slice(*np.searchsorted(columns[0], (places.start, places.stop)))
    orders, *others = (column[chosen] for column in columns)
    return orders - places.start, *others
