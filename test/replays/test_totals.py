"""Totals in `--metrics` are those of the texts: of one drive, and of several."""

import csv
from datetime import datetime, timedelta
from fnmatch import fnmatch
import math
from pathlib import Path
import re
import sys

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "logs"))
from exports import simulated

from docs.metric_table import METRICS
from evpinn_ros.replays.car import CarReplay
from evpinn_ros.replays.run import ReplayOptions
from evpinn_ros.replays.totals import metrics_csv, trends_csv
from evpinn_ros.report.breakdown_text import breakdown_lines
from evpinn_ros.report.owner_text import drives_rows, owner_line

pytestmark = pytest.mark.slow

HEAD = "Time,Speed (km/h),Voltage (V),Current (A),SOC (%)"
BEGIN = datetime(2024, 3, 5, 8)
CHARGED = 30 * 365 * 3595 / 3.6e6  # kWh of an hour
DRIVES = simulated(count=400, seed=5), simulated(count=300, seed=6)


def driven(number: int, begin: datetime, charge: float) -> list[str]:
    drive = DRIVES[number]
    columns = (3.6 * drive.speed, drive.voltage, drive.current, drive.charge - 80.0 + charge)
    times = (begin + timedelta(seconds=second) for second in drive.time.tolist())
    cells = zip(times, *columns, strict=True)
    return [f"{time},{v:.3f},{u:.2f},{i:.3f},{soc:.3f}" for time, v, u, i, soc in cells]


def plugged(begin: datetime) -> list[str]:
    """An hour at 30 A in which 15 % come in."""
    seconds = range(0, 3600, 5)
    return [f"{begin + timedelta(seconds=k)},0,365,-30,{75 + k / 240:.3f}" for k in seconds]


def replayed(tmp_path: Path, *parts: list[str]) -> CarReplay:
    """Each part a file, and a drive, however long it stands."""
    car = CarReplay("tesla_model_3_lr", ReplayOptions())
    for number, rows in enumerate(parts):
        (tmp_path / f"{number}.csv").write_text("\n".join([HEAD, *rows]) + "\n")
        car.replay(car.open(tmp_path / f"{number}.csv"))
    return car


def test_totals_of_two_drives_add_up(tmp_path):
    later = BEGIN + timedelta(hours=5)
    car = replayed(tmp_path, driven(0, BEGIN, 80.0), driven(1, later, 60.0))
    drives = car.metrics()
    assert drives[0]["together"] is None
    of_all = drives[-1]["together"]
    for drive, of_one in zip(DRIVES, drives, strict=True):
        assert of_one["totals"]["distance_m"] == pytest.approx(drive.distance, rel=1e-3)
        assert of_one["totals"]["energy_kwh"] == pytest.approx(drive.energy / 3.6e6, rel=1e-3)
    starts = [of_one["totals"]["start"] for of_one in drives]
    assert starts == ["2024-03-05T08:00:00", "2024-03-05T13:00:00"]
    table = [*csv.DictReader(metrics_csv(drives).splitlines())]
    assert [row["input.path"] for row in table][2:] == ["all 2"]
    for row, of_one in zip(table, (*drives, of_all), strict=True):
        assert float(row["totals.energy_kwh"]) == of_one["totals"]["energy_kwh"]
        assert float(row["breakdown.air.kwh"]) == of_one["breakdown"]["air"]["kwh"]
    assert float(table[-1]["health.percent"] or "nan") == pytest.approx(
        drives[-1]["health"]["percent"] or math.nan, nan_ok=True
    )
    assert [*table[0]][:2] == ["input.path", "totals.start"]
    assert trends_csv(drives) is None  # of two drives
    documented = {re.sub("<.*?>", "*", metric.key) for metric in METRICS}
    assert all(any(fnmatch(key, pattern) for pattern in documented) for key in table[0])
    total = of_all["totals"]
    for name in ("distance_m", "duration_s", "energy_kwh", "charged_kwh"):
        sum_of_both = sum(of_one["totals"][name] for of_one in drives)
        assert total[name] == pytest.approx(sum_of_both)
    assert (total["start"], total["charge_first_percent"]) == (starts[0], 80.0)
    assert total["charge_last_percent"] == pytest.approx(DRIVES[1].charge[-1] - 20.0, abs=1e-3)
    named = [("", result.drive, result.metrics) for result in car.results]
    assert drives_rows(named, car.breakdown())[-1][1] == f"{total['energy_kwh']:.2f}"
    assert total["kwh_per_100km"] == pytest.approx(1e5 * total["energy_kwh"] / total["measured_m"])


def test_a_charger_is_in_no_error_and_tells_the_health(tmp_path):
    stands = BEGIN + timedelta(seconds=420)
    car = replayed(tmp_path, driven(0, BEGIN, 80.0) + plugged(stands))
    (metrics,) = car.metrics()
    total = metrics["totals"]
    assert total["energy_kwh"] == pytest.approx(DRIVES[0].energy / 3.6e6, rel=0.02)
    assert total["charged_kwh"] == pytest.approx(CHARGED, rel=0.01)
    assert abs(metrics["energy"]["error_percent"]) < 15.0
    # 10.9 kWh for 15 % are 73 kWh, of 75 in the vehicle file
    assert metrics["health"]["capacity_kwh"] == pytest.approx(CHARGED / 0.15, rel=0.05)


def test_text_and_breakdown_have_one_total(tmp_path):
    """Where speed is missing for a while, the breakdown lacks what the battery gave there."""
    rows = driven(0, BEGIN, 80.0)
    rows[200:230] = [row.replace(row.split(",")[1], "", 1) for row in rows[200:230]]
    (result,) = replayed(tmp_path, rows).results
    total, parts = result.metrics["totals"], result.metrics["breakdown"]
    assert parts["measured"]["kwh"] + parts["left_out_kwh"] == pytest.approx(total["energy_kwh"])
    shown = f"{total['energy_kwh']:.2f} kWh"
    assert shown in owner_line(result.drive, result.metrics)
    based = breakdown_lines(parts)[-1]
    assert (f"of {shown} is not broken down" in based) == (
        f"{parts['measured']['kwh']:.2f} kWh" != shown
    )
