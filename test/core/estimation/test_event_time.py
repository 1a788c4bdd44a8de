"""How readings are cut into blocks, and in which order they come, changes nothing."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import PowerKind
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.outputs import Outputs, PowerRows, joined_outputs
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.core.vehicle.files import load_vehicle

START_NS = 1_700_000_000_000_000_000
VEHICLE = load_vehicle("tesla_model_3_lr")
SEEDS = [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 8))]


def drive(duration: float, rng: np.random.Generator) -> list[Reading]:
    """Readings of a drive with a gap of speed, a dropout and a slow altimeter, in order."""
    readings: list[Reading] = []
    period = rng.choice([0.05, 0.1, 0.2])
    for step in range(int(duration / period)):
        t = step * period
        stamp_ns = START_NS + round(t * NANOSECONDS)
        speed = max(0.0, 12 + 8 * math.sin(t / 7) + 5 * math.sin(t / 3.1))
        ahead = max(0.0, 12 + 8 * math.sin((t + 0.1) / 7) + 5 * math.sin((t + 0.1) / 3.1))
        force = 1900 * (ahead - speed) / 0.1 + 200 + 0.4 * speed**2
        power = force * speed * (1.1 if force > 0 else 0.7) + 800
        if not 40 < t < 44:
            readings.append(SpeedReading(stamp_ns, speed))
        if not 60 < t < 75:
            readings.append(BatteryReading(stamp_ns + 31_000_000, 350.0, -power / 350))
        if step % 20 == 3:
            readings.append(AltitudeReading(stamp_ns + 7_000_000, 100 + 20 * math.sin(t / 30)))
            readings.append(TemperatureReading(stamp_ns + 1_000_000, 5.0 + t / 100))
        if step % 50 == 7:
            readings.append(AuxiliaryReading(stamp_ns + 2_000_000, 500.0 + t))
        if step % 2 and t > 80:
            readings.append(MotorReading(stamp_ns + 3_000_000, force * 0.037, speed * 27.0))
    return sorted(readings, key=lambda reading: reading.stamp_ns)


def outputs_of(blocks: Sequence[Sequence[Reading]]) -> Outputs:
    estimator = OnlineEstimator(VEHICLE, EstimatorSettings(), InlineWorker(lambda: 0.0))
    parts = [estimator.add_block(Block.of(block)) for block in blocks]
    return joined_outputs([*parts, estimator.flush()])


def outputs_at_once(readings: Sequence[Reading]) -> Outputs:
    """What readings lead to that come one by one, as a node takes them."""
    estimator = OnlineEstimator(VEHICLE, EstimatorSettings(), InlineWorker(lambda: 0.0))
    parts = []
    powers: dict[PowerKind, list[tuple[float, ...]]] = {kind: [] for kind in PowerKind}
    for reading in readings:
        now, completed = estimator.add_reading(reading)
        if now is not None:
            powers[now.kind].append((now.stamp_ns, now.stamp_ns, now.power, now.sigma))
        if completed is not None:
            parts.append(completed)
    whole = joined_outputs([*parts, estimator.flush()])
    assert not len(whole.measured.power)
    measured, predicted = (
        PowerRows.of(*map(np.array, zip(*powers[kind], strict=True)))
        for kind in (PowerKind.MEASURED, PowerKind.PREDICTED)
    )
    columns = zip(predicted, whole.predicted, strict=True)  # those after a gap
    predicted = PowerRows._make(map(np.concatenate, columns))
    order = predicted.stamp_ns.argsort()
    predicted = PowerRows._make(column[order] for column in predicted)
    return whole._replace(measured=measured, predicted=predicted)


def assert_equal(whole: Outputs, other: Outputs, kinds: Sequence[str]) -> None:
    for kind in kinds:
        for name, a, b in zip(
            getattr(whole, kind)._fields, getattr(whole, kind), getattr(other, kind), strict=True
        ):
            assert len(a) == len(b), (kind, name)
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-6, err_msg=f"{kind}.{name}")
    assert [x.known_ns for x in whole.learned] == [x.known_ns for x in other.learned]
    for a, b in zip(whole.learned, other.learned, strict=True):
        values = [[p.value, p.std] for p in a.parameters.parameters.values()]
        assert values == pytest.approx(
            np.array([[p.value, p.std] for p in b.parameters.parameters.values()]), rel=1e-9
        )
        assert a.parameters.stamp_ns == b.parameters.stamp_ns


@pytest.mark.parametrize("seed", SEEDS)
def test_cuts_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    readings = drive(100.0, rng)
    whole = outputs_of([readings])
    assert len(whole.predicted.power) > 400
    assert len(whole.smoothed.power) > 400
    assert np.isfinite(whole.smoothed.energy).any()
    cuts = np.sort(rng.integers(0, len(readings), int(rng.integers(1, 60)))).tolist()
    blocks = [readings[a:b] for a, b in zip([0, *cuts], [*cuts, len(readings)], strict=True)]
    kinds = ("measured", "predicted", "smoothed")
    assert_equal(whole, outputs_of(blocks), kinds)
    assert_equal(whole, outputs_of([[reading] for reading in readings]), kinds)
    assert_equal(whole, outputs_at_once(readings), kinds)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_order_of_arrival_within_the_lateness_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    readings = drive(100.0, rng)
    late = [reading.stamp_ns + rng.integers(0, 280_000_000) for reading in readings]
    shuffled = [readings[index] for index in np.argsort(late, kind="stable")]
    whole = outputs_of([readings])
    assert_equal(whole, outputs_of([shuffled]), ("smoothed",))
    assert_equal(whole, outputs_of([[reading] for reading in shuffled]), ("smoothed",))
