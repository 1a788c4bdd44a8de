from collections.abc import Callable
import math

import numpy as np
import pytest

from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import load_vehicle

START_NS = 1_700_000_000 * NANOSECONDS


@pytest.fixture(scope="session")
def vehicle():
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="session")
def samples() -> list[Sample]:
    """Ten minutes at 10 Hz, in town and out of it, uphill and down, with a load that is known."""
    time = 0.1 * np.arange(6000)
    speed = 14.0 + 9.0 * np.sin(time / 31.0) + 4.0 * np.sin(time / 7.0)
    acceleration = np.gradient(speed, time) + 0.5 * np.sin(time / 3.0)
    grade = 0.02 * np.sin(time / 50.0)
    return [
        Sample(START_NS + i * NANOSECONDS // 10, float(v), float(a), float(g), 1.2, 300.0)
        for i, (v, a, g) in enumerate(zip(speed, acceleration, grade, strict=True))
    ]


@pytest.fixture(scope="session")
def teach() -> Callable:
    """Feed a method all samples, with power from a function of the sample."""

    def teach(method, samples, power):
        for sample in samples:
            method.observe(sample, power(sample))
        return method

    return teach


@pytest.fixture(scope="session")
def readings() -> list[Reading]:
    """Twenty seconds of speed at 10 Hz and of the battery, 30 ms later each."""
    rng = np.random.default_rng(3)
    found: list[Reading] = []
    for i in range(200):
        stamp = START_NS + i * NANOSECONDS // 10
        found.append(SpeedReading(stamp, 10.0 + 5.0 * math.sin(i / 40.0)))
        found.append(BatteryReading(stamp + 30_000_000, 350.0, float(rng.normal(-20.0, 15.0))))
    return found
