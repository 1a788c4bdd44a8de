"""How a drive is cut into blocks changes no output of the chain."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from itertools import chain
import time
from typing import Any

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import ParameterSet, PowerEstimate
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.replays.chain import Chain, ChainOutput
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

pytestmark = pytest.mark.slow
SECONDS = 45.0


def damaged(readings: list[Reading]) -> list[Reading]:
    """The drive with late and lost readings, a dropout, a gap and a slip, a third of it twice."""
    rng, start_ns = np.random.default_rng(0), readings[0].stamp_ns
    arrivals = []
    for reading in readings:
        second = (reading.stamp_ns - start_ns) / NANOSECONDS
        battery = isinstance(reading, BatteryReading)
        if rng.uniform() < 0.02 or (battery and 20.0 < second < 28.0) or 33.0 < second < 37.0:
            continue
        if isinstance(reading, SpeedReading) and 41.0 < second < 41.3:
            reading = replace(reading, speed=30.0)
        late = rng.uniform(0.0, 0.4) if rng.uniform() < 0.05 else 0.0
        arrivals.append((second + late, reading))
    arrivals.sort(key=lambda arrival: arrival[0])
    drive = [reading for _, reading in arrivals]
    third = len(drive) // 3
    return [*drive[: 2 * third], *drive[third:]]


def polled(readings: list[Reading]) -> list[Reading]:
    """The drive as a phone asks for it: speed and battery in turns, each every 1.2 s."""
    kinds = SpeedReading, BatteryReading
    apart = [[r for r in readings if isinstance(r, kind)] for kind in kinds]
    step = round(1.2 / ((apart[0][1].stamp_ns - apart[0][0].stamp_ns) / NANOSECONDS))
    chosen = [r for i, part in enumerate(apart) for r in part[i * step // 2 :: step]]
    return sorted(chosen, key=lambda reading: reading.stamp_ns)


def slow_sensors(readings: list[Reading]) -> list[Reading]:
    """The drive with each height and torque a second late, as receivers and gateways have them."""
    late_ns = {AltitudeReading: NANOSECONDS, MotorReading: NANOSECONDS}
    return sorted(readings, key=lambda r: r.stamp_ns + late_ns.get(type(r), 0))


DRIVES = {"damaged": damaged, "polled": polled, "slow_sensors": slow_sensors}


@pytest.fixture(scope="module", params=DRIVES)
def drive(request: pytest.FixtureRequest, vehicle: Any) -> list[Reading]:
    seconds = 3 * SECONDS if request.param == "polled" else SECONDS
    recorded = simulate(
        DriveKind.URBAN, vehicle, seconds, seed=3, altitude=True, motor_torque=True
    ).readings
    return DRIVES[request.param](list(recorded))


def numbers(value: Any) -> Iterator[float]:
    """Every number of an output, in order."""
    if is_dataclass(value):
        value = [getattr(value, field.name) for field in fields(value)]
    if isinstance(value, dict):
        value = value.values()
    if isinstance(value, (int, float, np.number)):
        yield float(value)
    elif not isinstance(value, str):
        for part in () if value is None else value:
            yield from numbers(part)


def outputs(drive: list[Reading], sizes: Iterator[int], vehicle: Any) -> list[ChainOutput]:
    """Outputs of the chain for a drive cut into blocks of these sizes."""
    whole = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    outputs_so_far: list[ChainOutput] = []
    begin = 0
    while begin < len(drive):
        end = begin + next(sizes)
        outputs_so_far += whole.add_readings(drive[begin:end])
        begin = end
    assert whole.estimator.status().accepted > 1
    return outputs_so_far


def sizes(cut: int | None) -> Iterator[int]:
    """Sizes of blocks: all the same, or random ones."""
    rng = np.random.default_rng(1)
    while True:
        yield int(rng.integers(1, 200)) if cut is None else cut


def kind(output: ChainOutput) -> str:
    """Type of an output, or the topic of a power."""
    return output.kind if isinstance(output, PowerEstimate) else type(output).__name__


def assert_equal(outputs_now: list[ChainOutput], expected: list[ChainOutput], what: str) -> None:
    """Of each kind; a block gives what it completes after what it tells at once."""
    outputs_now, expected = (
        sorted(some, key=lambda output: (kind(output), getattr(output, "stamp_ns", 0)))
        for some in (outputs_now, expected)
    )
    assert list(map(kind, outputs_now)) == list(map(kind, expected))
    columns = [[[*numbers(output)] for output in some] for some in (outputs_now, expected)]
    assert [*map(len, columns[0])] == [*map(len, columns[1])], what
    now, before = ([*chain.from_iterable(rows)] for rows in columns)
    np.testing.assert_allclose(now, before, rtol=1e-9, atol=1e-9, err_msg=what)


def test_cuts_change_no_output(drive, vehicle):
    alone = outputs(drive, sizes(1), vehicle)
    assert any(isinstance(output, ParameterSet) for output in alone)
    for cut in (7, None, len(drive) + 1):
        assert_equal(outputs(drive, sizes(cut), vehicle), alone, str(cut))


BOUNDS = (
    "energy.account.EXTENDED_AT", "energy.meter.BATCH", "signals.kinematics.SMOOTHED_AT_ONCE",
)  # fmt: skip


def test_how_much_is_computed_at_once_changes_no_output(drive, vehicle, monkeypatch):
    usual = outputs(drive, sizes(None), vehicle)
    for bound in BOUNDS:
        monkeypatch.setattr(f"evpinn_ros.core.{bound}", 3)
    assert_equal(outputs(drive, sizes(None), vehicle), usual, "by three")
