"""Estimator and energy account in one process, with the results of the nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
import math
from operator import itemgetter
from typing import Any, TypeAlias

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
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import Reading, SpeedReading
from evpinn_ros.core.signals.time_jump import (
    DEFAULT_RULE,
    Jump,
    JumpPolicy,
    JumpRule,
    StampGuard,
)
from evpinn_ros.core.signals.track import LATER
from evpinn_ros.core.vehicle.files import Vehicle

ChainOutput: TypeAlias = Output | Breakdown | EnergyState | AccountSummary


class Chain:
    """The estimator, whose outputs go to the energy account."""

    def __init__(
        self,
        vehicle: Vehicle,
        settings: EstimatorSettings,
        worker: InlineWorker,
        rule: JumpRule = DEFAULT_RULE,
    ) -> None:
        """Start from the vehicle's priors and zero energy; `worker` computes updates."""
        self.estimator = OnlineEstimator(vehicle, settings, worker)
        self._rule, self._guard = rule, StampGuard(SpeedReading)
        self._start: Mapping[str, Any] | None = None  # learned state when the drive began
        self.account = EnergyAccount(
            EnergyMeter(load_rknn()),
            vehicle.key,
            vehicle.battery_capacity,
            CarLimits.of(vehicle),
        )

    @property
    def dropped(self) -> Counter[str]:
        """Counts of readings of this drive that were refused or held by the guard, by reason."""
        guard = self._guard.dropped + Counter(stamp_leaps=self._guard.held)
        return guard + self.account.refused

    def add_readings(self, readings: Iterable[Reading]) -> Iterator[ChainOutput]:
        """Take readings in order of arrival; yields all outputs in order."""
        return self.take(self.follow(Block.of(readings)))

    def follow(self, block: Block) -> Iterator[Block | Jump]:
        """Take readings; yields jumps, and blocks of admitted readings for `take_block`."""
        for passed in self._guard.follow(block, self._rule):
            if isinstance(passed, Jump):
                yield passed
            elif len(admitted := self.account.admission.admit(passed)):
                yield admitted

    def take(self, items: Iterable[Block | Jump]) -> Iterator[ChainOutput]:
        """Take blocks of readings and jumps; yields all outputs in order.

        As in nodes, readings that wait at a jump of time are counted, but give no outputs.
        """
        for item in items:
            if isinstance(item, Jump):
                self.jump()
            else:
                yield from (output for _, output in self.take_block(item))

    def read(self, block: Block) -> Outputs:
        """Take admitted readings; `account.count` then returns the states of the account."""
        outputs = self.estimator.add_block(block)
        self._give(block, outputs)
        self._set_usual(self.estimator.model())
        return outputs

    def read_rest(self) -> Outputs:
        """Take the waiting readings of a finished drive; `account.flush` counts them."""
        outputs = self.estimator.flush()
        self._give(Block(0, {}), outputs)
        return outputs

    def _give(self, block: Block, outputs: Outputs) -> None:
        """Give the account readings, and the estimator's powers for them."""
        self.account.add_block(block)
        _, *measured = outputs.measured
        self.account.add_measured(*measured[:3])
        _, stamps, power, sigma, energy, energy_sigma = outputs.smoothed
        self.account.add_predicted(stamps, power, sigma, energy_sigma, energy)

    def take_block(
        self, block: Block, *, breakdowns: bool = False
    ) -> Iterator[tuple[int, ChainOutput]]:
        """Take readings; yields outputs, each with the stamp of the reading that completed it.

        These are outputs of the estimator, of the account and, if wanted, breakdowns.
        """
        usual = self.estimator.model()
        outputs = self.estimator.add_block(block, breakdowns=breakdowns)
        self._give(block, outputs)
        yield from self._account_outputs(outputs, usual)

    def take_rest(self) -> Iterator[tuple[int, ChainOutput]]:
        """`take_block` for the waiting readings of a finished drive."""
        usual = self.estimator.model()
        yield from self._account_outputs(self.read_rest(), usual)

    def _account_outputs(
        self, outputs: Outputs, usual: CarModel | None
    ) -> Iterator[tuple[int, ChainOutput]]:
        """Outputs of the estimator, followed by those of the account, in order of stamps."""
        rows: list[tuple[int, ChainOutput]] = [*outputs.in_order()]
        rows += (
            (learned.known_ns, learned.breakdown)
            for learned in outputs.learned
            if learned.breakdown is not None
        )
        models = [(learned.known_ns, learned.model) for learned in outputs.learned]
        completed_ns = dict(
            zip(*(column.tolist() for column in outputs.smoothed[1::-1]), strict=True)
        )
        while (due_ns := self.account.summary_due_ns()) != LATER:
            rows += self._states(due_ns, completed_ns)
            at_ns = completed_ns.get(due_ns, due_ns)
            while models and models[0][0] < at_ns:
                _, usual = models.pop(0)
            self._set_usual(usual)
            rows.append((at_ns, self.account.show()))
        rows += self._states(LATER, completed_ns)
        self._set_usual(self.estimator.model())
        yield from sorted(rows, key=itemgetter(0))

    def _states(
        self, until_ns: int, completed_ns: Mapping[int, int]
    ) -> Iterator[tuple[int, EnergyState]]:
        """States of the account up to a stamp, each with the stamp that completed it."""
        for state in self.account.count(until_ns).rows():
            yield completed_ns.get(state.stamp_ns, state.stamp_ns), state

    def _set_usual(self, car: CarModel | None) -> None:
        self.account.usual = math.nan if car is None else usual_cost(car)

    def jump(self) -> None:
        """Handle a jump of time: join nothing across it; by the policy `reset`, start anew."""
        if self._rule.policy is not JumpPolicy.RESET:
            self.estimator.handle_time_jump()
            self.account.begin_after_jump()
            return
        self.estimator.reset()
        if self._start is not None:
            self.estimator.restore(self._start)
        self.account.begin_next_trip()

    def begin_next_drive(self) -> None:
        """Keep the learned car; time and energy start anew."""
        self.estimator.begin_next_drive()
        self.estimator.clear_counters()
        self._guard, self._start = StampGuard(SpeedReading), self.estimator.export()
        self.account.begin_after_jump()
        self.account.reset_trip()
        self.account.refused.clear()
