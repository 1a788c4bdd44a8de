"""Plans made of driven trips: what they keep of a drive, and that forecasts are its replay."""

from dataclasses import replace
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.plans import intervals_of, plan_of, weather_of
from benchmarks.unseen.drives import load_car
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.power_model import PowerModel
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.journey import NOWHERE
from evpinn_ros.core.estimation.posterior import interval_terms
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.interval import Interval

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
SIMULATED = "bags/urban", "tesla_model_3_lr"
GIVEN = {
    "e208": ("peugeot_e208_car_scanner/2023-12-07_20-18-19.csv.gz", "generic"),
    "leaf2013": ("nissan_leaf_2013_leafspy/Log_leaf_170516_24CA1.csv.gz", "nissan_leaf"),
    "model3": ("tesla_model3/drive_first_757s.csv", "tesla_model_3_lr"),
    "i3": ("bmw_i3/TripB34.csv.gz", "bmw_i3"),
    "changchun": ("changchun_sedan/trip_022.csv.gz", "generic"),
    "can_model3": ("can/tesla_model3_2019/decoded_first_300s.csv", "tesla_model_3_lr"),
    "can_model_s": ("can/tesla_model_s_2017/decoded_2017-02-19.csv", "tesla_model_s"),
    "can_leaf": ("can/nissan_leaf_62kwh/decoded_EV-CANepluseco.csv", "nissan_leaf"),
}


def learned_half(path: Path, vehicle: str) -> tuple[CarModel, list[Interval]]:
    """A car that learned the first half of a drive, and the measured intervals of the rest."""
    car = load_car("", f"{path}={vehicle}")
    intervals = max((list(intervals_of(car, drive)) for drive in car.drives), key=len)
    middle = len(intervals) // 2
    learned = LearnedCar.new(equation_of(car.vehicle)).after(intervals[:middle])
    model = replace(learned.state.model(learned.equation), unevenness=learned.uneven())
    return model, [interval for interval in intervals[middle:] if not math.isnan(interval.energy)]


def as_planned(done: list[Interval]) -> list[Interval]:
    """Intervals with what the plan is given: its temperature and load, and no torque.

    A plan that is flat all along is one whose heights are not known.
    """
    weather = weather_of(done, loads=True)
    steady = {
        "air_density": weather.air_density,
        "celsius": weather.celsius,
        "load": weather.heating or 0.0,
        "load_known": weather.heating is not None,
    }
    hilly = any(interval.steps.climb.any() for interval in done)
    return [
        replace(
            interval,
            steps=interval.steps._replace(
                motor_drive=np.full_like(interval.steps.duration, math.nan)
            ),
            conditions=interval.conditions._replace(**steady),
            height_known=hilly,
        )
        for interval in done
    ]


def check_forecast_is_the_replay(model: CarModel, done: list[Interval]) -> None:
    done = as_planned(done)
    journey, seconds = NOWHERE, model.seconds
    for interval in done:
        journey = journey.plus(interval_terms(model.equation, interval, seconds).journey)
        seconds += interval.duration
    planned = PowerModel(model)
    # Early in a drive its heating may yet stray, which a replay does not count.
    energy, sigma = replace(model, covariance=planned.covariance).predicted(journey)
    forecast = forecast_plan(plan_of(done, "1 s"), planned, weather_of(done, loads=True))
    gross = sum(abs(interval.energy) for interval in done)
    assert abs(forecast.energy[-1] - energy) < 0.005 * gross
    assert forecast.sigma[-1] == pytest.approx(sigma, rel=0.01)


def test_forecast_of_a_driven_speed_is_its_withheld_replay():
    path, vehicle = SIMULATED
    check_forecast_is_the_replay(*learned_half(ROOT / path, vehicle))


@pytest.mark.nightly
@pytest.mark.parametrize("key", GIVEN)
def test_so_it_is_on_given_cars(key):
    path, vehicle = GIVEN[key]
    if not (DATA / path).exists():
        pytest.skip(f"{DATA / path} is not there")
    check_forecast_is_the_replay(*learned_half(DATA / path, vehicle))
