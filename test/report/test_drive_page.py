"""The report of a drive as text: whole, self-contained, and safe whatever a bag holds."""

from dataclasses import replace
from html.parser import HTMLParser
import json
from pathlib import Path
import re

import numpy as np
import pytest

from evpinn_ros.common.units import METRIC, US
from evpinn_ros.replays.driven import measured_steps
from evpinn_ros.replays.history import PowerSeries
from evpinn_ros.report.drive_charts import speed_energy_chart
from evpinn_ros.report.drive_page import ReportedDrive, write_drives
from test.report.test_thinning import unpacked

pytestmark = pytest.mark.slow

HOSTILE = "</script><img src=x onerror=alert(1)>'\"&\u2028\udcff"


class Page(HTMLParser):
    """What a browser would find in a page.

    Attributes:
        tags: every element with its attributes.
        headings: text of those of the second and third level.
        words: text that a person reads, in order.
        data: that the plots are drawn from.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.headings: list[str] = []
        self.words = ""
        self.text = path.read_text("utf-8")
        self._now = ""
        self.feed(self.text)

    def handle_starttag(self, tag, attributes):
        self._now = "plots" if dict(attributes).get("id") == "plots" else tag
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        self._now = ""

    def handle_data(self, data):
        if self._now not in ("plots", "script", "style"):
            self.words += data
        if self._now in ("h2", "h3"):
            self.headings.append(data)
        elif self._now == "plots":
            self.data = json.loads(data)

    @property
    def plots(self) -> list[str]:
        return [named["data-plot"] for _, named in self.tags if "data-plot" in named]


def page(tmp_path, *drives: ReportedDrive, command="evpinn replay x", units=METRIC) -> Page:
    path = tmp_path / "deep" / "report.html"
    write_drives(path, drives, command, units)
    return Page(path)


def with_path(reported: ReportedDrive, path: str) -> ReportedDrive:
    metrics = dict(reported.metrics) | {"input": dict(reported.metrics["input"]) | {"path": path}}
    return replace(reported, metrics=metrics)


def test_a_steady_speed_takes_what_the_true_car_would(reported, tmp_path):
    """The band of the learned car holds the truth of the simulation, in the units of the page."""
    truth, car = reported.truth, reported.vehicle
    for units in (METRIC, US):
        chart = page(tmp_path, reported, units=units).data[0]["charts"]["by_speed"]
        low, middle, high = (unpacked(chart[name]) for name in ("low", "middle", "high"))
        speed = (chart["start"] + np.arange(len(middle))) * units.metres / 3600
        drag = 0.5 * car.air_density * car.frontal_area * truth.c_d * speed**2
        force = (drag + truth.mass * truth.c_rr * 9.81) / truth.eta
        true = (force + truth.p_aux / speed) * units.metres / 3600
        driven = speed * 3.6 < 60
        assert ((low < true) & (true < high))[driven].all()
        # Slowly it is mostly standing load, which a drive so short hardly tells.
        assert (high - low < middle)[driven & (speed * 3.6 > 30)].all()


def test_bars_by_speed_are_what_was_measured(reported, tmp_path):
    chart = page(tmp_path, reported).data[0]["charts"]["by_speed"]
    begin, per_km, km = np.array(chart["bars"]).T
    steps = measured_steps(reported.drive)
    inside = np.isin(np.floor(steps.speed * 3.6 / chart["width"]) * chart["width"], begin)
    assert len(begin) >= 2 and begin.min() >= chart["width"]
    assert km.sum() == pytest.approx(steps.distance[inside].sum() / 1000)
    assert per_km @ km == pytest.approx(steps.energy[inside].sum() / 3600)


def on_a_square(reported: ReportedDrive) -> ReportedDrive:
    """Twice around a square of 1 km, first to the north, at 50 degrees north."""
    time = np.linspace(0.0, reported.drive.duration, 801)
    way = np.linspace(0.0, 8.0, 801) % 4.0
    north = np.interp(way, [0, 1, 2, 3, 4], [0, 1, 1, 0, 0])
    east = np.interp(way, [0, 1, 2, 3, 4], [0, 0, 1, 1, 0])
    degrees = 1 / 111.195
    latitude = 50.0 + north * degrees
    longitude = 10.0 + east * degrees / np.cos(np.radians(50.0))
    position = np.column_stack((time, latitude, longitude))
    return replace(reported, drive=replace(reported.drive, position=position))


def test_a_drive_with_a_position_has_a_map(reported, tmp_path):
    assert "map" not in page(tmp_path, reported).plots
    report_page = page(tmp_path, on_a_square(reported))
    assert "Where it was driven" in report_page.headings and "map" in report_page.plots
    chart = report_page.data[0]["charts"]["map"]
    east, north, time, power = (unpacked(chart[n]) for n in ("east", "north", "time", "power"))
    for side in (east, north):
        assert (side.min(), side.max()) == pytest.approx((0.0, 1.0), abs=0.01)
    assert north[np.searchsorted(time, time[-1] / 8)] == pytest.approx(1.0, abs=0.02)
    spent = np.nansum(power[1:] * np.diff(time))
    measured = measured_steps(reported.drive).energy.sum() / 1000
    assert spent == pytest.approx(measured, rel=0.1)  # but for the gaps


def test_units_of_the_united_states_stand_alone(reported, tmp_path):
    metric, us = (page(tmp_path / u.speed[:2], reported, units=u) for u in (METRIC, US))
    assert re.search(r"\d mph", us.words) and "mi/kWh" in us.words and "Wh/mi" in us.words
    assert not re.search(r"\bkm\b|km/h|°C", us.words)
    axes = [chart.get("axis", chart.get("axes")) for chart in us.data[0]["charts"].values()]
    assert "km" not in str(axes)
    speeds = [
        unpacked(shown.data[0]["charts"]["speed"]["series"][0]["values"]) for shown in (metric, us)
    ]
    assert np.nanmax(speeds[0]) / np.nanmax(speeds[1]) == pytest.approx(1.609344, rel=1e-3)


def test_nothing_is_fetched_and_nothing_else_runs(reported, tmp_path):
    report_page = page(tmp_path, reported)
    assert not [tag for tag, _ in report_page.tags if tag in ("link", "iframe", "img", "object")]
    assert not [a for _, a in report_page.tags if {"src", "href"} & a.keys()]
    assert not [a for _, a in report_page.tags if any(name.startswith("on") for name in a)]
    (policy,) = [
        a["content"] for tag, a in report_page.tags if tag == "meta" and "http-equiv" in a
    ]
    assert "default-src 'none'" in policy
    assert re.search(r"script-src 'sha256-\S+' 'sha256-\S+';", policy)


def test_what_a_bag_holds_is_text(reported, tmp_path):
    harmless = page(tmp_path / "a", with_path(reported, "out/town"))
    dropped = {"dropped": {HOSTILE: 3}}
    hostile = with_path(reported, f"out/{HOSTILE}")
    metrics = dict(hostile.metrics) | {"input": dict(hostile.metrics["input"]) | dropped}
    attacked = page(tmp_path / "b", replace(hostile, metrics=metrics), command=HOSTILE)
    assert [tag for tag, _ in attacked.tags] == [tag for tag, _ in harmless.tags]
    assert attacked.data == harmless.data


@pytest.mark.parametrize(
    ("share", "dated", "said", "column"),
    [(1.5, True, "+50.00 %", "began, local time"), (3.0, False, "kWh", "began")],
)
def test_the_list_of_drives_says_the_clock_once_and_no_error_of_hundreds_of_percent(
    reported, tmp_path, share, dated, said, column
):
    """A drive downhill takes nearly nothing."""
    measured = reported.metrics["energy"]["measured_j"]
    wrong = {"predicted_j": share * measured, "error_percent": 100.0 * (share - 1.0)}
    energy = dict(reported.metrics["energy"]) | wrong
    changed = replace(reported, metrics=dict(reported.metrics) | {"energy": energy})
    start_ns = 1_709_622_489 * 10**9
    drives = [
        replace(changed, drive=replace(reported.drive, start_ns=start, zoned=False))
        for start in (start_ns, start_ns if dated else 0)
    ]
    write_drives(tmp_path / "page.html", drives, "evpinn replay")
    table = (tmp_path / "page.html").read_text().partition("<tbody>")
    assert f"<th>{column}</th>" in table[0]
    first = table[2].partition("</tr>")[0]
    assert said in first.rpartition("<td>")[2] and ("local time" in first) != dated


def rows(count: int) -> np.ndarray:
    return np.zeros((0, count))


def without_battery(reported: ReportedDrive) -> ReportedDrive:
    power = {"rmse_w": None, "mae_w": None, "r2": None, "coverage_90": None}
    energy = dict(reported.metrics["energy"]) | {"measured_j": None, "error_percent": None}
    scores = {"power": {"lag_s": None, **power}, "power_now": power, "energy": energy}
    drive = replace(reported.drive, measured=rows(2), models=())
    return replace(reported, drive=drive, metrics=dict(reported.metrics) | scores)


def single_reading(reported: ReportedDrive) -> ReportedDrive:
    """A drive that ended as it began."""
    silent = without_battery(reported)
    nothing = PowerSeries(*np.empty((4, 0)))
    drive = replace(
        silent.drive,
        duration=0.0,
        speed=np.array([[0.0, 3.0]]),
        smoothed=nothing,
        newest=nothing,
        energy=rows(4),
        parameters={name: rows(4) for name in silent.drive.parameters},
        combinations={name: rows(3) for name in silent.drive.combinations},
        final=None,
        start_ns=-(2**62),
    )
    metrics = dict(silent.metrics) | {"parameters": {}}
    return replace(silent, drive=drive, metrics=metrics, truth=None)


@pytest.mark.parametrize("less", [without_battery, single_reading])
def test_what_is_missing_is_said(reported, tmp_path, less):
    report_page = page(tmp_path, less(reported))
    assert (
        "The battery was not measured" in report_page.text
        and "No part of this drive" in report_page.text
    )
    assert set(report_page.plots) == set(report_page.data[0]["charts"])


def test_wild_numbers_of_a_bag_make_a_page(reported, tmp_path):
    """Stamps of another century, and powers that no battery has."""
    measured = reported.drive.measured.copy()
    measured[5:8, 1] = (1e300, -1.7e308, 1.7e308)
    speed = np.vstack((reported.drive.speed, [[9e9, 1e30]]))
    drive = replace(reported.drive, measured=measured, speed=speed, duration=9e9)
    with np.errstate(over="ignore"):
        report_page = page(tmp_path, replace(reported, drive=drive))
    assert {*report_page.plots} == {*report_page.data[0]["charts"]} and len(report_page.text) < 3e6


def test_steady_speed_is_no_surer_than_a_dropout_of_this_car(reported):
    steps = measured_steps(reported.drive)

    def widths(trust):
        model = replace(reported.drive.model, trust=trust)
        drive = replace(reported.drive, model=model)
        chart = speed_energy_chart(drive, reported.vehicle, steps, METRIC)
        return unpacked(chart["high"]) - unpacked(chart["low"])

    np.testing.assert_allclose(widths(4.0), 2.0 * widths(1.0), rtol=0.01)
