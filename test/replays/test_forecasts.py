"""A drive as the plan it would have been, asked of the car as it was known before."""

from dataclasses import replace
import time

import numpy as np
import pytest

from evpinn_ros.core.energy.driven import drive_plan
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.forecasts import forecast_outcomes
from evpinn_ros.replays.history import MODEL_STEP, History, KnownModel


@pytest.fixture(scope="module")
def drive(readings, vehicle):
    """Two minutes of which nothing was learned: its model is that of the vehicle file."""
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    history = History()
    history.add_model(0, chain.estimator.model())
    for reading in readings:
        history.add_reading(reading)
    return history.drive()


def test_each_part_is_forecast_by_the_model_of_its_begin(drive):
    first = drive.models[0].model
    halved = replace(first, mean=0.5 * first.mean)
    half = drive.duration / 2
    models = (drive.models[0], KnownModel(half, halved))
    parts = forecast_outcomes(replace(drive, models=models))
    whole = forecast_outcomes(replace(drive, models=(drive.models[0],)))
    again = forecast_outcomes(replace(drive, models=(drive.models[0], KnownModel(half, first))))
    assert [part.span.begin for part in parts] == [0.0, half]
    assert parts[0] == again[0]
    assert parts[1].forecast == pytest.approx(again[1].forecast / 2)
    total = sum(part.measured for part in again)
    assert total == pytest.approx(whole[0].measured, rel=0.05)


@pytest.mark.parametrize("series", ["speed", "measured"])
def test_a_part_with_a_gap_is_not_compared(drive, series):
    rows = getattr(drive, series)
    gappy = replace(drive, **{series: rows[np.abs(rows[:, 0] - 50.0) > 2.0]})
    assert forecast_outcomes(gappy) == []


def test_slow_readings_have_no_gap_and_a_charger_is_in_no_plan(drive):
    """A row every four seconds, as an app logs; then the same with the car plugged in."""
    slow = replace(drive, speed=drive.speed[::40], measured=drive.measured[::40])
    (part,) = forecast_outcomes(slow)
    assert part.covered
    speed, power = slow.speed.copy(), slow.measured.copy()
    speed[-5:, 1], power[-5:, 1] = 0.0, -7000.0
    assert forecast_outcomes(replace(slow, speed=speed, measured=power)) == []


def test_a_plan_climbs_as_its_altitudes_do():
    time = np.arange(0.0, 101.0, 0.5)
    speed = np.stack((time, np.full(len(time), 20.0)), axis=1)
    height = np.stack((time, 0.02 * 20.0 * time), axis=1)
    plan = drive_plan(speed, height)
    assert plan.distance[-1] == pytest.approx(20.0 * plan.time[-1])
    middle = slice(20, 80)  # smoothing rounds the ends
    grade = np.diff(plan.elevation[middle]) / np.diff(plan.distance[middle])
    assert grade == pytest.approx(0.02, abs=1e-3)
    for without in (height[:0], height * [1.0, 0.0]):  # a receiver may have no fix
        plan = drive_plan(speed, without)
        assert not plan.elevation.any() and not plan.level


def test_models_are_kept_every_few_minutes(readings, vehicle):
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    history, kept = History(), []
    first = readings[0]
    for second in range(0, 1000):
        now_ns = first.stamp_ns + second * 10**9
        history.add_reading(replace(first, stamp_ns=now_ns))
        if history.wants_model(now_ns):
            history.add_model(now_ns, chain.estimator.model())
            kept.append(second)
    assert np.diff(kept).tolist() == [MODEL_STEP] * 3
    history.add_model(now_ns, None)
    assert len(history.drive().models) == 4
