"""What an owner asks first: kilometres, kilowatt hours, and what took most."""

from copy import deepcopy
from pathlib import Path
import time

import pytest

from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.over_distance import distance_until
from evpinn_ros.replays.owner_text import DRIVES_COLUMNS, drives_rows, owner_line
from evpinn_ros.replays.run import Replayed, ReplayOptions, replay
from evpinn_ros.signals.readings import SpeedReading
from test.replays.test_replay import Recorded


def replayed(vehicle, readings) -> Replayed:
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    source, options = Recorded(list(readings), Path("town")), ReplayOptions(warm_up=30.0)
    return replay(source, chain, options, vehicle=vehicle.key, mode="hybrid")


@pytest.fixture(scope="module")
def town(vehicle, readings) -> Replayed:
    return replayed(vehicle, readings)


def test_the_line_holds_what_was_measured(town):
    km = distance_until(town.drive)[1][-1] / 1000
    kwh = town.metrics["energy"]["measured_j"] / 3.6e6
    line = owner_line(town.drive, town.metrics)
    assert line.startswith(f"{km:.1f} km in 2 min: {kwh:.2f} kWh from the battery, ")
    consumption = float(line.split(", ")[1].split()[0])
    assert consumption == pytest.approx(kwh / km * 100, rel=0.15)  # of what was learned from


def test_without_a_battery_the_energy_is_predicted(vehicle, readings):
    found = replayed(vehicle, (each for each in readings if isinstance(each, SpeedReading)))
    line = owner_line(found.drive, found.metrics)
    assert "kWh predicted, " in line and "from the battery" not in line
    ((_, *_, most, rmse, error),) = drives_rows([("town", found.drive, found.metrics)])
    assert (most, rmse, error) == ("-", "-", "-")


def test_a_row_holds_what_took_most(town):
    found = deepcopy(town.metrics)
    found["breakdown"]["together"] = []
    for part in found["breakdown"].values():
        if isinstance(part, dict) and "kwh" in part:
            part.update(kwh=1.0, sigma_kwh=0.1, share=0.1)
    found["breakdown"]["tyres"].update(kwh=3.0, share=0.3)
    found["breakdown"]["air"].update(kwh=9.0, sigma_kwh=9.0, share=0.9)  # not known
    (row,) = drives_rows([("town", town.drive, found)])
    assert dict(zip(DRIVES_COLUMNS, row, strict=True))["took most"] == "tyres, 30 %"
