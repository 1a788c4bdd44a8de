"""The chain of cores: readings to power, parameters and energy, as the three nodes do it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

from evpinn_ros.energy.meter import EnergyMeter, EnergyState
from evpinn_ros.energy.rknn import load_rknn
from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator, Output
from evpinn_ros.estimation.worker import Worker
from evpinn_ros.signals.readings import NANOSECONDS, Reading
from evpinn_ros.vehicle.files import Vehicle

JUMP_NS = 10 * NANOSECONDS  # stamps that go back further are no stragglers

ChainOutput: TypeAlias = Output | EnergyState


class Chain:
    """Estimator and energy meter, the one behind the other."""

    def __init__(self, vehicle: Vehicle, settings: EstimatorSettings, worker: Worker) -> None:
        """Start at the vehicle's priors and at zero energy."""
        self.estimator = OnlineEstimator(vehicle, settings, worker)
        self.meter = EnergyMeter(load_rknn())

    def push(self, reading: Reading) -> Iterator[ChainOutput]:
        """Take one reading; give all that the estimator and then the meter say of it."""
        for output in self.estimator.push(reading):
            yield output
            if not isinstance(output, PowerEstimate):
                continue
            if output.kind is PowerKind.SMOOTHED:
                self._follow_time(output.stamp_ns)
                self.meter.push_predicted(output.stamp_ns, output.power, output.sigma)
                yield self.meter.state
            elif output.kind is PowerKind.MEASURED:
                self.meter.push_measured(output.stamp_ns, output.power, output.sigma)

    def _follow_time(self, stamp_ns: int) -> None:
        """When stamps go back, as in a recording that starts over, count on from there."""
        if self.meter.state.stamp_ns - stamp_ns > JUMP_NS:
            self.meter.restore(self.meter.exported())

    def begin_next_drive(self) -> None:
        """Keep what was learned of the car; time and energy start anew."""
        self.estimator.handle_time_jump()
        self.estimator.clear_counters()
        self.meter.reset()
