"""The report of a drive in a real Chromium."""

import base64
from dataclasses import replace
import io
from pathlib import Path
import re

from matplotlib.image import imread
import numpy as np
import pytest

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.replays.driven import DrivenSteps, measured_steps, travelled
from evpinn_ros.report.drive_page import write_drives

pytestmark = pytest.mark.browser

INKED = """Array.from(document.querySelectorAll('canvas'), canvas => {
  const copy = new OffscreenCanvas(canvas.width, canvas.height)
    .getContext('2d', { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  return new Set(new Uint32Array(data.buffer)).size;
})"""
AS_PNG = "Array.from(document.querySelectorAll('canvas'), canvas => canvas.toDataURL())"
WIDTHS = "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"


@pytest.fixture(scope="module")
def page(reported, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_drives(path, [reported], "evpinn replay out/town")
    return path


def pictures(browser) -> list[np.ndarray]:
    """Every canvas, shape (height, width, 4) each."""
    texts = browser.run(AS_PNG)
    return [imread(io.BytesIO(base64.b64decode(text.partition(",")[2]))) for text in texts]


def differ(some: list[np.ndarray], others: list[np.ndarray]) -> list[bool]:
    """Which canvases show something else, beyond the few pixels that a redraw rounds anew."""
    return [
        a.shape != b.shape or float((np.abs(a - b) > 0.1).any(axis=2).mean()) > 1e-3
        for a, b in zip(some, others, strict=True)
    ]


def box(browser, plot: str) -> tuple[float, float, float, float]:
    """Left, top, width and height of the inside of a plot, scrolled into view."""
    return browser.run(f"""(() => {{
      const over = document.querySelector("[data-plot='{plot}'] .u-over");
      over.scrollIntoView({{ block: "center" }});
      const found = over.getBoundingClientRect();
      return [found.left, found.top, found.width, found.height];
    }})()""")


def zoom(browser, plot: str, begin: float, end: float) -> None:
    """Drag across a plot, between two shares of its width."""
    left, top, width, height = box(browser, plot)
    y = top + height / 2
    browser.drag((left + begin * width, y), (left + end * width, y))
    browser.settle()


@pytest.mark.parametrize(("width", "dark"), [(1100, False), (500, True), (390, False)])
def test_every_plot_is_drawn_without_a_word(browser, page, width, dark):
    browser.open(page, width=width, dark=dark)
    inked = browser.run(INKED)
    assert len(inked) == 18 and min(inked) > 5  # colours: axes, grid and what is drawn
    whole, seen = browser.run(WIDTHS)
    assert whole <= seen == width or (width > 600 and whole <= seen)
    assert browser.troubles == []
    assert browser.requests == [page.as_uri()]


def test_a_stretch_has_its_own_figures(browser, reported, page):
    browser.open(page, width=1100)
    whole = stretch(browser)
    zoom(browser, "speed", 0.4, 0.7)
    part = stretch(browser)
    driven, measured = travelled(reported.drive), measured_steps(reported.drive)
    for begin, end, km, kmh, kwh, consumption, *_ in (whole, part):
        # The stretch is known to the pixel, its times are shown to the second.
        far, known = (between(steps, begin, end) for steps in (driven, measured))
        assert km == pytest.approx(far.distance.sum() / 1000, abs=0.03)
        assert kmh == pytest.approx(3600 * km / far.seconds.sum(), rel=0.03)
        assert kwh == pytest.approx(known.energy.sum() / 3.6e6, abs=0.02)
        over = known.distance.sum() / 1e5
        assert consumption * over == pytest.approx(kwh, rel=0.03, abs=0.001)
    browser.run("document.querySelector('button').click()")
    browser.settle()
    assert stretch(browser) == whole and browser.troubles == []


def between(steps: DrivenSteps, begin: float, end: float) -> DrivenSteps:
    return chosen_rows(steps, (steps.end > begin) & (steps.end <= end))


def stretch(browser) -> list[float]:
    """Begin and end, s, and the numbers that follow in the line of figures."""
    first, *rest = browser.run(
        "Array.from(document.querySelectorAll('.stretch span'), s => s.innerText)"
    )
    times = [
        60.0 * int(minutes) + int(seconds)
        for minutes, seconds in (text.split(":") for text in first.split(" to "))
    ]
    return [
        *times,
        *(float(text.split()[0].replace("\u2212", "-").replace("charge", "0")) for text in rest),
    ]


def test_values_show_under_the_cursor(browser, page):
    browser.open(page, width=1100)
    browser.run("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    browser.settle()
    for plot, words in (
        ("power", ("measured", "predicted", "to")),
        ("mass", ("truth", "prior", "%")),
        ("outcome", ("forecast", "±")),
        ("by_speed", ("steady, flat", "to")),
    ):
        left, top, width, height = box(browser, plot)
        where = {"x": left + 0.6 * width, "y": top + 0.5 * height}
        browser.call("Input.dispatchMouseEvent", type="mouseMoved", **where)
        browser.settle()
        text = browser.run(f"document.querySelector(\"[data-plot='{plot}']\").innerText")
        assert all(word in text for word in words), (plot, text)
        assert any(character.isdigit() for character in text)
    left, top, width, height = box(browser, "coverage")
    where = {"x": left + 2, "y": top + 0.5 * height}
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", **where)
    browser.settle()
    assert "0 to 5 km/h" in browser.run("document.querySelector('.readout').innerText")
    assert browser.troubles == []


def test_a_map_shows_power_where_it_is_pointed_at(browser, reported, tmp_path):
    """A road straight to the north stands upright in the middle; the stretch shown is strong."""
    time = np.linspace(0.0, reported.drive.duration, 300)
    place = np.column_stack((time, 48.0 + time / 1e4, np.full(300, 11.0)))
    path = tmp_path / "map.html"
    drive = replace(reported.drive, position=place)
    write_drives(path, [replace(reported, drive=drive)], "evpinn replay x")
    browser.open(path, width=1100)
    left, top, width, height = box(browser, "map")
    where = {"x": left + 0.5 * width, "y": top + 0.5 * height}
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", **where)
    readout = "document.querySelector(\"[data-plot='map'] + .readout\").innerText"
    assert re.fullmatch(r"1:1\d: \S+ kW|1:1\d: not measured", browser.run(readout))
    where["x"] = left + 0.1 * width
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", **where)
    assert "Point at the road" in browser.run(readout)
    before = pictures(browser)[1]
    zoom(browser, "speed", 0.4, 0.5)
    assert differ([before], [pictures(browser)[1]]) == [True]
    assert browser.troubles == []


def test_text_of_a_bag_does_not_run(browser, reported, tmp_path):
    """The policy holds even if a script came through."""
    path = tmp_path / "hostile.html"
    write_drives(path, [reported], "</code><script>document.title = 'owned'</script>")
    browser.open(path, width=1100)
    assert browser.run("document.title") == "Drive town" and browser.troubles == []
    text = path.read_text("utf-8")
    path.write_text(text.replace("</h1>", "</h1><script>document.title = 'owned'</script>"))
    browser.open(path, width=1100)
    assert browser.run("document.title") == "Drive town"
    assert "Content Security Policy" in " ".join(browser.troubles)
