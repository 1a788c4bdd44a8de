"""Readings of every kind and no sense: never an exception, never a number that is not finite."""

import math

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import ParameterSet, PowerKind
from evpinn_ros.core.estimation.estimator import Mode
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    GradeReading,
    SpeedReading,
    TemperatureReading,
)

START = 1_700_000_000 * NANOSECONDS
PLAUSIBLE = st.one_of(st.floats(-40.0, 60.0), st.floats(-0.3, 0.3), st.just(0.0))
numbers = st.one_of(
    PLAUSIBLE, PLAUSIBLE, st.floats(allow_nan=True, allow_infinity=True), st.just(1e300)
)
others = st.sampled_from([AltitudeReading, AuxiliaryReading, GradeReading, TemperatureReading])


def check(outputs) -> None:
    for output in outputs:
        if isinstance(output, ParameterSet):
            for estimate in output.parameters.values():
                values = (estimate.value, estimate.std, estimate.lower, estimate.upper)
                assert all(map(math.isfinite, values)) and 0.0 <= estimate.prior_share <= 1.0
                assert estimate.lower <= estimate.value <= estimate.upper
            assert all(map(math.isfinite, (*output.identifiable, *output.identifiable_std)))
        else:
            assert math.isfinite(output.power)
            measured = output.kind is PowerKind.MEASURED
            assert measured or (math.isfinite(output.sigma) and output.sigma > 0)


@st.composite
def rides(draw):
    """Bursts of steady driving between nonsense of all kinds, jumps and reversals of time."""
    stamp, readings = START, []
    for _ in range(draw(st.integers(1, 8))):
        stamp += draw(
            st.one_of(
                st.integers(0, 200_000_000),
                st.integers(-5_000_000_000, 5_000_000_000),
                st.integers(-(2**62), 2**62),
            )
        )
        speed, current = draw(st.floats(-30.0, 60.0)), draw(st.floats(-1000.0, 1000.0))
        step = draw(st.sampled_from([1, 10_000_000, 100_000_000, 1_000_000_000]))
        slope = draw(st.floats(-0.5, 0.5))
        for k in range(draw(st.integers(0, 40))):
            stamp += step
            readings.append(SpeedReading(stamp, speed + slope * k))
            readings.append(BatteryReading(stamp + draw(st.integers(-3, 3)), 350.0, current))
        for _ in range(draw(st.integers(0, 6))):
            moment = stamp + draw(st.integers(-2_000_000_000, 2_000_000_000))
            kind = draw(st.integers(0, 2))
            if kind == 0:
                readings.append(SpeedReading(moment, draw(numbers)))
            elif kind == 1:
                readings.append(BatteryReading(moment, draw(numbers), draw(numbers)))
            else:
                readings.append(draw(others)(moment, draw(numbers)))
    return readings


@given(readings=rides())
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@pytest.mark.slow
def test_hybrid_takes_anything(new_estimator, readings):
    estimator = new_estimator()
    for reading in readings:
        check(estimator.add_readings([reading]))
    check([estimator.parameters()])
    estimator.export()


@pytest.mark.torch
def test_paper_takes_a_drive_full_of_nonsense(new_estimator, drive):
    rng = np.random.default_rng(0)
    readings = list(drive(1, 240.0).readings[: 20 * 30])
    for _ in range(60):
        stamp = readings[0].stamp_ns + int(rng.integers(0, 30)) * NANOSECONDS
        value = rng.choice([math.nan, math.inf, -math.inf, 1e300, -5.0, 90.0])
        kind = rng.choice([SpeedReading, GradeReading, TemperatureReading, AuxiliaryReading])
        readings.insert(int(rng.integers(0, len(readings))), kind(stamp, float(value)))
    estimator = new_estimator(mode=Mode.PAPER)
    for reading in readings:
        check(estimator.add_readings([reading]))
    assert estimator.status().updates > 0
