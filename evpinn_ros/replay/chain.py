"""The chain of cores: readings to power, parameters and energy, as the three nodes do it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

from evpinn_ros.energy.account import AccountSummary, EnergyAccount
from evpinn_ros.energy.meter import EnergyMeter, EnergyState
from evpinn_ros.energy.rknn import load_rknn
from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator, Output
from evpinn_ros.estimation.worker import Worker
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.vehicle.files import Vehicle

JUMP_NS = 10 * NANOSECONDS  # stamps that go back further are no stragglers

ChainOutput: TypeAlias = Output | EnergyState | AccountSummary


class Chain:
    """Estimator and energy account, the one behind the other."""

    def __init__(self, vehicle: Vehicle, settings: EstimatorSettings, worker: Worker) -> None:
        """Start at the vehicle's priors and at zero energy."""
        self.estimator = OnlineEstimator(vehicle, settings, worker)
        self.account = EnergyAccount(
            EnergyMeter(load_rknn()), vehicle.key, vehicle.battery_capacity
        )

    @property
    def meter(self) -> EnergyMeter:
        """Of the account."""
        return self.account.meter

    def push(self, reading: Reading) -> Iterator[ChainOutput]:
        """Take one reading; give all that the estimator and then the account say of it."""
        if isinstance(reading, SpeedReading):
            self.account.push_speed(reading.stamp_ns, reading.speed)
        elif isinstance(reading, BatteryReading):
            self.account.push_battery(reading)
        for output in self.estimator.push(reading):
            yield output
            if not isinstance(output, PowerEstimate):
                continue
            if output.kind is PowerKind.SMOOTHED:
                self._follow_time(output.stamp_ns)
                self.account.push_predicted(
                    output.stamp_ns, output.power, output.sigma, output.energy_sigma
                )
                yield self.account.state
                summary = self.account.tick()
                if summary is not None:
                    yield summary
            elif output.kind is PowerKind.MEASURED:
                self.account.push_measured(output.stamp_ns, output.power, output.sigma)

    def _follow_time(self, stamp_ns: int) -> None:
        """When stamps go back, as in a recording that starts over, count on from there."""
        if self.meter.state.stamp_ns - stamp_ns > JUMP_NS:
            self.account.begin_next_stretch()

    def begin_next_drive(self) -> None:
        """Keep what was learned of the car; time and energy start anew."""
        self.estimator.begin_next_drive()
        self.estimator.clear_counters()
        self.account.begin_next_stretch()
        self.account.reset_trip()
