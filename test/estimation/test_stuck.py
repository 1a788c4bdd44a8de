"""A sensor that hangs: nothing is learned from it, and a stuck battery is not measured."""

import math
import time

import pytest

from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.signals.stuck import BATTERY_STUCK, SPEED_STUCK
from evpinn_ros.vehicle.files import load_vehicle

FROM, UNTIL = 5.0, 20.0  # s


@pytest.mark.parametrize("stuck", [SPEED_STUCK, BATTERY_STUCK])
def test_a_stuck_sensor_teaches_nothing(stuck):
    estimator = OnlineEstimator(
        load_vehicle("tesla_model_3_lr"), EstimatorSettings(), InlineWorker(time.perf_counter)
    )
    kinds = []
    for step in range(round(10 * UNTIL)):
        now = step / 10
        speed, current = 14 + 8 * math.sin(now / 3), -60 - 150 * math.cos(now / 3)
        if now > FROM:
            speed = 15.0 if stuck == SPEED_STUCK else speed
            current = -40.0 if stuck == BATTERY_STUCK else current
        stamp_ns = NANOSECONDS + round(now * NANOSECONDS)
        for reading in (BatteryReading(stamp_ns, 350.0, current), SpeedReading(stamp_ns, speed)):
            outputs = estimator.push(reading)
            kinds += [(now, o.kind) for o in outputs if isinstance(o, PowerEstimate)]
    status = estimator.status()
    assert status.stuck == stuck and status.gated[stuck] > 20
    late = {kind for now, kind in kinds if now > UNTIL - 5.0}
    assert {PowerKind.PREDICTED, PowerKind.SMOOTHED} <= late
    assert (PowerKind.MEASURED in late) == (stuck == SPEED_STUCK)
