"""The battery at the end of drives: charge and voltage, by what was learned on those before.

Energy over the learned capacity and the voltage at the start held stand beside the state of the
battery. `battery_rows` takes the measured power of a drive as the plan, so that no error of the
car's model is in its figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import math
from typing import NamedTuple

import numpy as np

from benchmarks.logs import Log
from evpinn_ros.drives.sources import open_source
from evpinn_ros.energy.account import EnergyAccount
from evpinn_ros.energy.charge import Uncertain
from evpinn_ros.energy.forecast import Forecast, battery_after
from evpinn_ros.energy.meter import EnergyMeter
from evpinn_ros.energy.rknn import load_rknn
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading
from evpinn_ros.vehicle.files import Vehicle, load_vehicle

END = 50  # samples at the end whose mean voltage is the truth
STEP = 1.0  # s of the plan
LEEWAY = 10.0  # s by which the battery may be known for less than the plan lasts


class BatteryRow(NamedTuple):
    """One drive; None where nothing could be forecast."""

    used: float  # drop of the state of charge, 0..1
    by_capacity: float | None  # error of the state of charge at the end, by energy over capacity
    by_state: float | None  # the same by the state of the battery
    voltage_held: float  # voltage at the start less that at the end, V
    voltage_by_state: float | None  # error of the voltage by the state of the battery, V


class BatteryBenchmark:
    """One car's battery, forecast and then learned, drive after drive."""

    def __init__(self, vehicle: Vehicle) -> None:
        meter = EnergyMeter(load_rknn())
        self._account = EnergyAccount(meter, vehicle.key, vehicle.battery_capacity)

    def drive(
        self, readings: Iterable[Reading], forecast: Forecast | None = None
    ) -> BatteryRow | None:
        """The battery at the end of a drive, which is then learned from.

        Without a forecast of its energy its measured power is the plan.

        Returns:
            None where the drive does not tell its state of charge from its start to its end.
        """
        known = [
            reading
            for reading in readings
            if isinstance(reading, BatteryReading)
            and math.isfinite(reading.power + reading.state_of_charge)
        ]
        if len(known) <= END:
            return None
        self._account.begin_next_trip()
        self._account.add_reading(known[0])  # what is known when the plan is asked for
        plan = _driven(known) if forecast is None else forecast
        length = (known[-1].stamp_ns - known[0].stamp_ns) / NANOSECONDS
        same = abs(length - (plan.time[-1] - plan.time[0])) <= LEEWAY
        row = self._row(known, plan) if same else None
        for reading in known[1:]:
            self._account.add_measured(reading.stamp_ns, reading.power, 0.0)
            self._account.add_reading(reading)
        return row

    def _row(self, known: Sequence[BatteryReading], plan: Forecast) -> BatteryRow:
        begin, end = known[0], known[-1]
        charge = Uncertain(begin.state_of_charge, 0.0)
        simple = battery_after(plan, charge, self._account.gauge.capacity)
        state = self._account.battery.after(plan, charge)
        voltage = float(np.mean([reading.voltage for reading in known[-END:]]))
        return BatteryRow(
            begin.state_of_charge - end.state_of_charge,
            simple.value - end.state_of_charge if simple.known else None,
            None if state is None else state.charge.value - end.state_of_charge,
            begin.voltage - voltage,
            None if state is None else state.voltage - voltage,
        )


def battery_rows(logs: Sequence[Log]) -> Iterator[tuple[str, BatteryRow]]:
    """Each drive of a car that tells its state of charge, by path, of known power."""
    vehicle = load_vehicle(logs[0].vehicle)
    benchmark = BatteryBenchmark(vehicle)
    for log in logs:
        row = benchmark.drive(open_source(log.path, vehicle, log.can_profile).readings())
        if row is not None:
            yield str(log.path), row


def _driven(known: Sequence[BatteryReading]) -> Forecast:
    """The forecast that knows the power."""
    time = np.array([(each.stamp_ns - known[0].stamp_ns) / NANOSECONDS for each in known])
    power = np.array([each.power for each in known])
    steps = np.diff(time) * (power[1:] + power[:-1]) / 2
    grid = np.append(np.arange(0.0, time[-1], STEP), time[-1])
    energy = np.interp(grid, time, np.concatenate(([0.0], np.cumsum(steps))))
    last = np.full(len(grid), float(np.mean(power[-END:])))
    return Forecast(grid, energy, last, np.zeros(len(grid)))
