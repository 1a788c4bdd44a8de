"""The report of a drive as text: whole, self-contained, and safe whatever a bag holds."""

from dataclasses import replace
from html.parser import HTMLParser
import json
from pathlib import Path
import re

import numpy as np
import pytest

from evpinn_ros.replay.breakdown_text import PAPER, breakdown_metrics, shown
from evpinn_ros.replay.history import PowerSeries
from evpinn_ros.report.drive_page import ReportedDrive, write_drives
from evpinn_ros.report.html import BROWSER, UPLOT

HEADINGS = [
    "The drive",
    "What was learned",
    "What could be known",
    "Where the data lay, and where predictions were off",
    "Forecast against outcome",
    "Events",
]
HOSTILE = "</script><img src=x onerror=alert(1)>'\"&\u2028\udcff"


class Page(HTMLParser):
    """What a browser would find in a page.

    Attributes:
        tags: every element with its attributes.
        headings: text of those of the second level.
        data: that the plots are drawn from.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.headings: list[str] = []
        self.text = path.read_text("utf-8")
        self._now = ""
        self.feed(self.text)

    def handle_starttag(self, tag, attributes):
        self._now = "plots" if dict(attributes).get("id") == "plots" else tag
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        self._now = ""

    def handle_data(self, data):
        if self._now == "h2":
            self.headings.append(data)
        elif self._now == "plots":
            self.data = json.loads(data)

    @property
    def plots(self) -> list[str]:
        return [found["data-plot"] for _, found in self.tags if "data-plot" in found]


def page(tmp_path, *drives: ReportedDrive, command="evpinn replay x") -> Page:
    path = tmp_path / "deep" / "report.html"
    write_drives(path, drives, command)
    return Page(path)


def with_path(reported: ReportedDrive, path: str) -> ReportedDrive:
    found = dict(reported.found) | {"input": dict(reported.found["input"]) | {"path": path}}
    return replace(reported, found=found)


def test_the_whole_story_is_told(reported, tmp_path):
    found = page(tmp_path, reported, command="evpinn replay out/town")
    assert found.headings == HEADINGS
    assert "<code>evpinn replay out/town</code>" in found.text
    assert set(found.plots) == set(found.data[0]["charts"]) and len(found.plots) == 16
    for text in (
        "baseline: last value held",
        "baseline: random split",
        "unestimated",
        "battery dropout",
        "Where the energy went",
        "other standing load",
    ):
        assert text in found.text
    assert "svg" in [tag for tag, _ in found.tags]
    assert len(found.data[0]["events"]) == 2


def test_nothing_is_fetched_and_nothing_else_runs(reported, tmp_path):
    found = page(tmp_path, reported)
    assert not [tag for tag, _ in found.tags if tag in ("link", "iframe", "img", "object")]
    assert not [a for _, a in found.tags if {"src", "href"} & a.keys()]
    assert not [a for _, a in found.tags if any(name.startswith("on") for name in a)]
    (policy,) = [a["content"] for tag, a in found.tags if tag == "meta" and "http-equiv" in a]
    assert "default-src 'none'" in policy
    assert re.search(r"script-src 'sha256-\S+' 'sha256-\S+';", policy)


def test_what_a_bag_holds_is_text(reported, tmp_path):
    harmless = page(tmp_path / "a", with_path(reported, "out/town"))
    dropped = {"dropped": {HOSTILE: 3}}
    hostile = with_path(reported, f"out/{HOSTILE}")
    found = dict(hostile.found) | {"input": dict(hostile.found["input"]) | dropped}
    attacked = page(tmp_path / "b", replace(hostile, found=found), command=HOSTILE)
    assert [tag for tag, _ in attacked.tags] == [tag for tag, _ in harmless.tags]
    assert attacked.data == harmless.data


def test_several_drives_open_one_by_one(reported, tmp_path):
    found = page(tmp_path, reported, reported)
    assert ["open" in a for tag, a in found.tags if tag == "details"] == [True, False]
    assert len(found.data) == 2 and "<title>2 drives</title>" in found.text


def rows(count: int) -> np.ndarray:
    return np.zeros((0, count))


def without_battery(reported: ReportedDrive) -> ReportedDrive:
    power = {"rmse_w": None, "mae_w": None, "r2": None, "coverage_90": None}
    energy = dict(reported.found["energy"]) | {"measured_j": None, "error_percent": None}
    scores = {"power": {"lag_s": None, **power}, "power_now": power, "energy": energy}
    drive = replace(reported.drive, measured=rows(2), models=())
    return replace(reported, drive=drive, found=dict(reported.found) | scores)


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
    found = dict(silent.found) | {"parameters": {}}
    return replace(silent, drive=drive, found=found, truth=None)


@pytest.mark.parametrize("less", [without_battery, single_reading])
def test_what_is_missing_is_said(reported, tmp_path, less):
    found = page(tmp_path, less(reported))
    assert "The battery was not measured" in found.text and "No part of this drive" in found.text
    assert set(found.plots) == set(found.data[0]["charts"])


def test_wild_numbers_of_a_bag_make_a_page(reported, tmp_path):
    """Stamps of another century, and powers that no battery has."""
    measured = reported.drive.measured.copy()
    measured[5:8, 1] = (1e300, -1.7e308, 1.7e308)
    speed = np.vstack((reported.drive.speed, [[9e9, 1e30]]))
    drive = replace(reported.drive, measured=measured, speed=speed, duration=9e9)
    with np.errstate(over="ignore"):
        found = page(tmp_path, replace(reported, drive=drive))
    assert found.headings == HEADINGS and len(found.text) < 3e6


def test_uplot_is_the_release_that_it_says():
    """The first line names the version that the docs name; its licence lies beside it."""
    script = (UPLOT / "uPlot.iife.min.js").read_text("utf-8")
    assert script.startswith("/*! https://github.com/leeoniya/uPlot (v1.6.32) */")
    assert "MIT License" in (UPLOT / "LICENSE").read_text("utf-8")
    for path in BROWSER.rglob("*.js"):
        assert "</script" not in path.read_text("utf-8").lower()


def test_the_bar_is_as_long_as_what_took_energy(reported, tmp_path):
    """Boxes stand side by side without a gap, each as wide as its share of what took energy."""
    found = page(tmp_path, reported)
    boxes = [a for tag, a in found.tags if tag == "rect" and a["class"].startswith("part")]
    begins, widths = (np.array([float(box[side]) for box in boxes]) for side in ("x", "width"))
    assert begins == pytest.approx(np.concatenate(([0.0], np.cumsum(widths)[:-1])), abs=0.5)
    breakdown = reported.found["breakdown"]
    took = [part["kwh"] for _, part in shown(breakdown) if part["kwh"] > 0.0]
    assert widths / widths.sum() == pytest.approx(np.array(took) / sum(took), abs=1e-3)


def test_a_drive_without_a_breakdown_says_why(reported, tmp_path):
    nothing = breakdown_metrics(None, "paper")
    found = page(tmp_path, replace(reported, found=dict(reported.found) | {"breakdown": nothing}))
    assert PAPER in found.text
    assert "rect" not in [tag for tag, _ in found.tags]
