"""Means of drives by week and by temperature, weighted by distance."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import ParameterEstimate, ParameterSet, Trust
from evpinn_ros.core.signals.readings import DRIVE_START_NS, NANOSECONDS
from evpinn_ros.core.vehicle.identifiable import Identifiable
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.trends import CAPACITY, ROLLING, drive_point, trends
from test.replays.conftest import made

MONDAY = 1_700_438_400 * NANOSECONDS  # 2023-11-20
WEEK = 7 * 86_400 * NANOSECONDS


def drive(start_ns: int, celsius: float, minutes: float, kilowatts: float, c_rr: float) -> Drive:
    """A drive at 20 m/s and a steady power, over which the charge falls by 20 %."""
    time = np.arange(0.0, 60.0 * minutes + 1.0)
    rolling = ParameterEstimate(c_rr, 1e-3, 0.2, 0.004, 0.02, Trust.VALID, progress=100.0)
    unknown = Identifiable(*[0.0] * len(Identifiable._fields))
    return made(
        duration=float(time[-1]),
        speed=np.column_stack((time, np.full(time.size, 20.0))),
        measured=np.column_stack((time, np.full(time.size, 1e3 * kilowatts))),
        final=ParameterSet(0, {"c_rr": rolling}, unknown, unknown, True),
        start_ns=start_ns,
        charge=np.array([[0.0, 0.8], [time[-1], 0.6]]),
        temperature=np.array([[0.0, celsius]]),
    )


DRIVES = [
    drive(MONDAY, 3.0, 10.0, 12.0, 0.012),
    drive(MONDAY + WEEK - NANOSECONDS, 4.0, 30.0, 16.0, 0.010),
    drive(MONDAY + WEEK, 11.0, 10.0, 10.0, 0.008),
]


def points(drives):
    return [drive_point(reported) for reported in drives]


POINTS = points(DRIVES)


def test_drives_are_weighted_by_their_distance():
    trend_by_title = {trend.title: trend for trend in trends(POINTS)}
    weeks = trend_by_title["consumption, kWh/100 km by week"].rows
    assert [row.name for row in weeks] == ["week of 2023-11-20", "week of 2023-11-27"]
    assert weeks[0].mean == pytest.approx((10 * 12.0 + 30 * 16.0) / 40 / 72.0 * 100)
    assert (weeks[0].drives, weeks[0].distance) == (2, pytest.approx(48_000.0))
    assert weeks[0].spread > 0.0 and weeks[1].spread < 1e-9
    warm = trend_by_title[f"{ROLLING} by outside temperature"].rows
    assert [row.name for row in warm] == ["0 to 5 °C", "10 to 15 °C"]
    assert warm[0].mean == pytest.approx((10 * 0.012 + 30 * 0.010) / 40)
    capacity = trend_by_title[f"{CAPACITY} by week"].rows
    assert capacity[1].mean == pytest.approx(10.0 / 6.0 / 0.2)


def test_a_rolling_resistance_that_cannot_be_trusted_is_left_out():
    doubted = [replace(reported, final=_doubted(reported.final)) for reported in DRIVES]
    assert not any(ROLLING in trend.title for trend in trends(points(doubted)))


def _doubted(parameters: ParameterSet) -> ParameterSet:
    return replace(
        parameters, parameters={"c_rr": replace(parameters.parameters["c_rr"], possible=False)}
    )


def test_too_few_drives_and_those_without_a_day_have_no_trend():
    assert trends(POINTS[:2]) == []
    undated = [replace(reported, start_ns=DRIVE_START_NS) for reported in DRIVES]
    assert undated and not any("by week" in trend.title for trend in trends(points(undated)))
