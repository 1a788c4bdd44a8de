"""One car of a bridge: the chain of its readings, its drives, and its saved state."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
import time
from typing import Any

import numpy as np

from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.state_file import Half
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading, SpeedReading
from evpinn_ros.core.signals.time_jump import Jump, JumpPolicy, JumpRule
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.nodes.saved_state import StateFile
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.energy_metrics import account_metrics, breakdown_metrics
from evpinn_ros.replays.scoring import combination_metrics, parameter_metrics

DRIVE_GAP_NS = 15 * 60 * NANOSECONDS
"""A drive ends after this time without speed, or at standstill."""
STANDS = 0.1  # m/s
HELD = JumpRule(policy=JumpPolicy.HOLD)
"""A clock set back on the broker's host must not reset the learned state."""

Document = Mapping[str, Any]


class BridgedCar:
    """The chain of one car: takes readings, returns documents to publish."""

    def __init__(
        self, name: str, vehicle: Vehicle, settings: EstimatorSettings, state: Path | None = None
    ) -> None:
        """Start from the state file of the car if it exists and is usable."""
        self.name, self.vehicle, self._settings = name, vehicle, settings
        self.chain = Chain(vehicle, settings, InlineWorker(time.perf_counter), HELD)
        # Stamp of the last confirmed reading, None before the first; follows a clock set back.
        self.newest_ns: int | None = None
        self.readings = 0  # number of readings so far
        self._moved_ns: int | None = None
        self._power: dict[PowerKind, PowerEstimate] = {}
        self._files = [
            StateFile(state, self.chain.estimator, Half.LEARNED),
            StateFile(state, self.chain.account, Half.ENERGY),
        ]
        self._saved = 0
        for state_file in self._files:
            state_file.restore()
        self.chain.begin_next_drive()

    @property
    def problem(self) -> str | None:
        """Reason why its state was not used or not written, or None."""
        return next((file.problem for file in self._files if file.problem is not None), None)

    def add_readings(self, readings: Iterable[Reading]) -> bool:
        """Take readings in order; returns True if another drive began with them."""
        began = False
        waiting: list[Block | Jump] = []
        for reading in readings:
            self.readings += 1
            # Only readings that pass the guard of time count: one wild stamp ends no drive.
            for item in self.chain.follow(Block.of([reading])):
                if isinstance(item, Block):
                    if self._is_next(item):
                        self._take(waiting)
                        waiting = []
                        self.save()
                        self._power.clear()
                        self.chain.begin_next_drive()
                        began = True
                    self.newest_ns = int(item.stamps()[-1])
                waiting.append(item)
        self._take(waiting)
        return began

    def _take(self, items: Sequence[Block | Jump]) -> None:
        for output in self.chain.take(items):
            if isinstance(output, PowerEstimate):
                self._power[output.kind] = output

    def _is_next(self, block: Block) -> bool:
        """True if the car moves after a long stop: another drive begins."""
        speeds = block.of_kind(SpeedReading)
        moving_ns = speeds.stamps[np.abs(speeds.values[0]) >= STANDS]
        if not len(moving_ns):
            return False
        moved_ns, self._moved_ns = self._moved_ns, int(moving_ns[-1])
        return moved_ns is not None and int(moving_ns[0]) - moved_ns >= DRIVE_GAP_NS

    def save(self) -> None:
        """Write the learned state and the account, if there were new readings."""
        if self.readings == self._saved:
            return
        for state_file in self._files:
            state_file.save()
        self._saved = self.readings

    def power(self) -> Document:
        """Document of battery power, W: measured, predicted, and 1-sigma of the prediction."""
        measured, predicted = (
            self._power.get(kind) for kind in (PowerKind.MEASURED, PowerKind.PREDICTED)
        )
        return {
            "time": _seconds(predicted.stamp_ns if predicted else None),
            "measured_w": measured and measured.power,
            "predicted_w": predicted and predicted.power,
            "predicted_sigma_w": predicted and predicted.sigma,
        }

    def documents(self) -> Mapping[str, Document]:
        """All other documents, by the last part of their topic."""
        self.chain.account.flush()  # shows measurements at once
        estimator, account = self.chain.estimator, account_metrics(self.chain.account.show())
        parameters = estimator.parameters()
        combinations = {"combinations": combination_metrics(parameters)}
        return {
            **account,
            "energy": {"time": _seconds(self.newest_ns), **account["energy"]},
            "breakdown": breakdown_metrics(
                estimator.breakdown(),
                self._settings.mode.value,
                parameters.parameters["mass"].state,
            ),
            "parameters": {**parameter_metrics(parameters), **combinations},
        }

    def health(self) -> Document:
        """Document of activity and problems, which explains missing updates."""
        status = self.chain.estimator.status()
        return {
            "activity": status.activity.value,
            "vehicle": self.vehicle.key,
            "readings": self.readings,
            "newest_time": _seconds(self.newest_ns),
            "dropped": {**status.dropped, **self.chain.dropped},
            "not_learned": dict(status.gated),
            "stuck": status.stuck,
            "unknown": list(status.unknown),
            "problem": self.problem,
        }


def _seconds(stamp_ns: int | None) -> float | None:
    return None if stamp_ns is None else stamp_ns / NANOSECONDS
