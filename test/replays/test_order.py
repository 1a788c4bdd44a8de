"""Part of a bundled bag whose battery readings are held up on their way, each differently."""

from collections.abc import Iterable
import random
from typing import Any

import pytest

from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading
from evpinn_ros.core.signals.stream import StreamSettings
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.run import span
from test.replays.conftest import URBAN

pytestmark = pytest.mark.slow

SECONDS = 90.0  # of the bag
MARGIN = 0.011  # s: stamps within a hundredth are of one moment


def outputs(vehicle: Vehicle, readings: Iterable[Reading]) -> list[str]:
    """All that is published, digit by digit; what was measured in the order of its stamps."""
    estimator = OnlineEstimator(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
    published: list[Any] = [
        output for reading in readings for output in estimator.add_reading(reading)
    ]
    assert not estimator.status().dropped and estimator.status().accepted > 7
    measured = [each for each in published if is_measured(each)]
    measured.sort(key=lambda each: each.stamp_ns)
    return [repr(each) for each in (*measured, *(e for e in published if not is_measured(e)))]


def is_measured(output: Any) -> bool:
    return isinstance(output, PowerEstimate) and output.kind is PowerKind.MEASURED


def test_readings_permuted_within_the_allowed_lateness_change_nothing(vehicle: Vehicle) -> None:
    limit_blas_threads()
    chance = random.Random(0)
    late_ns = round((StreamSettings().allowed_lateness - MARGIN) * NANOSECONDS)

    def arrival(reading: Reading) -> int:
        held_up = isinstance(reading, BatteryReading)
        return reading.stamp_ns + (chance.randrange(late_ns) if held_up else 0)

    readings = list(span(open_source(URBAN, vehicle).readings(), 0.0, SECONDS))
    permuted = sorted(readings, key=arrival)
    assert sum(a is not b for a, b in zip(readings, permuted, strict=True)) > 1000
    assert outputs(vehicle, permuted) == outputs(vehicle, readings)
