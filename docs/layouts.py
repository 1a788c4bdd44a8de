"""The pictures of docs/guides/viewing.md: a simulated drive in the two ready layouts.

Foxglove's is a photograph of the last open Foxglove Studio that npm holds, in a headless Chromium,
with our layout imported and the recorded bag opened. PlotJuggler is no package here, so its
picture is drawn from its layout file: the same tabs, panels, series and scales.

Run: python docs/layouts.py (`make layouts` does); needs Chromium and npm.
"""

from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory
import threading
import time
from typing import Any
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import plan_from_speed_profile
from evpinn_ros.core.energy.power_model import Weather
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.diagnosis import Condition, Health
from evpinn_ros.nodes.estimator_diagnosis import estimator_status
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.forecasts import known_model
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from evpinn_ros.topics import DIAGNOSTICS, DIAGNOSTICS_TYPE, FORECAST, NAMED_VECTOR_TYPE, NAMESPACE
from evpinn_ros.topics.energies import output_messages
from evpinn_ros.topics.estimates import breakdown_messages
from evpinn_ros.topics.messages import diagnostics, header
from evpinn_ros.topics.plans import forecast_message
from evpinn_ros.topics.readings import reading_messages

ROOT = Path(__file__).resolve().parents[1]
VIEWS = ROOT / "config" / "views"
LAYOUTS = {
    name: VIEWS / file
    for name, file in (("foxglove", "foxglove.json"), ("plotjuggler", "plotjuggler.xml"))
}
VEHICLE = "tesla_model_3_lr"
PACKAGES = ("@foxglove/studio-base@1.48.0", "react@17.0.2", "react-dom@17.0.2")
BROWSERS = ("chromium", "chromium-browser", "chrome")
SIZE = "1920,1200"
MOST_S = 600.0  # that drawing may take
SECONDS, SEED = 1200.0, 7  # of the drive: long enough for a range
PLAN_PERIOD_NS = 20 * NANOSECONDS  # between two plans
# Eight kilometres in town: times, s, distances, m, speeds, m/s.
PLAN = ([0.0, 15.0, 585.0, 600.0], [0.0, 105.0, 8085.0, 8190.0], [0.0, 14.0, 14.0, 0.0])

Series = dict[str, list[tuple[float, float]]]  # time, s, and value


def picture_of(name: str) -> Path:
    """Where the picture of a layout lies."""
    return ROOT / "docs" / f"layout_{name}.png"


def record(out: Path) -> None:
    """A bag of all topics of a simulated drive, as the nodes publish them.

    Every now and then the energy of one plan is asked, as a planner would.
    """
    vehicle = load_vehicle(VEHICLE)
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    plan = plan_from_speed_profile(*map(np.array, PLAN))
    asked_ns = 0
    with BagWriter(out) as writer:
        for reading in simulate(DriveKind.MIXED, vehicle, SECONDS, SEED).readings:
            now_ns, messages = reading.stamp_ns, list(reading_messages(new_message, reading))
            for output in chain.add_reading(reading):
                messages += output_messages(new_message, output)
                if not isinstance(output, ParameterSet):
                    continue
                messages += breakdown_messages(new_message, now_ns, chain.estimator.breakdown())
                well = Condition(Health({}, {}), 0.0, 0, None)
                name, *rest = estimator_status(chain.estimator.status(), well)
                status = (f"{NAMESPACE}/estimator: {name}", *rest)
                messages.append(
                    (DIAGNOSTICS, diagnostics(new_message, now_ns, [status], NAMESPACE))
                )
                if now_ns - asked_ns >= PLAN_PERIOD_NS:
                    asked_ns = now_ns
                    model = known_model(chain.estimator.model(), output, vehicle)
                    answer = forecast_plan(plan, model, Weather(vehicle.air_density))
                    columns = (answer.time, answer.energy, answer.power, answer.sigma)
                    forecast = forecast_message(new_message, header(new_message, now_ns), *columns)
                    messages.append((FORECAST, forecast))
            for topic, message in messages:
                writer.write(topic.under(NAMESPACE), message, now_ns)


# Foxglove -------------------------------------------------------------------------------------


def photograph(bag: Path, folder: Path) -> None:
    """Open layout and bag in Foxglove Studio, and photograph it."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        sys.exit("docs/layouts.py: no Chromium here: apt-get install chromium")
    for package in PACKAGES:
        name = package.rpartition("@")[0].rpartition("/")[2]
        packed = subprocess.run(
            ["npm", "pack", "--silent", package], cwd=folder, check=True, capture_output=True
        )
        shutil.unpack_archive(folder / packed.stdout.decode().split()[-1], folder / name)
    shutil.copy(next(bag.glob("*.mcap")), folder / "drive.mcap")
    shutil.copy(LAYOUTS["foxglove"], folder / "layout.json")
    shutil.copy(ROOT / "docs" / "layouts.html", folder / "index.html")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Page, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with BagReader(bag) as reader:
        end_ns = max(stamp for _, stamp in reader.log_times())
    end = np.datetime64(end_ns - NANOSECONDS, "ns")
    page = f"http://127.0.0.1:{server.server_port}/index.html?ds=drive&time={end}Z"
    quiet = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
    picture = folder / "foxglove.png"
    options = (f"--window-size={SIZE}", f"--screenshot={picture}", f"--user-data-dir={folder}/own")
    subprocess.run([browser, *quiet, *options, page], check=True, stderr=subprocess.DEVNULL)
    server.shutdown()
    keep(picture, "foxglove")


class Page(SimpleHTTPRequestHandler):
    """The files of a folder, and an image that comes late: with it the page counts as loaded."""

    drawn = threading.Event()

    def do_GET(self) -> None:
        """Wait for the page before its last image is given."""
        if self.path == "/drawn":
            self.drawn.set()
        elif self.path == "/late.png":
            self.drawn.wait(MOST_S)
        super().do_GET()

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


# PlotJuggler ----------------------------------------------------------------------------------


def series_of(bag: Path, wanted: set[str]) -> Series:
    """Series by the names that PlotJuggler gives them, of those wanted."""
    series: Series = {}
    with BagReader(bag) as reader:
        begin = None
        for record in reader.records():
            begin = begin or record.log_time_ns
            time = (record.log_time_ns - begin) / NANOSECONDS
            for name, value in _numbers(record.topic, record.message, wanted):
                if name in wanted:
                    series.setdefault(name, []).append((time, value))
    return series


def _numbers(topic: str, message: Any, wanted: set[str]) -> Iterator[tuple[str, float]]:
    """Names and values in a message; of arrays without names none."""
    kind = message.__msgtype__
    if kind == NAMED_VECTOR_TYPE:
        for field in ("position", "velocity", "effort"):
            values = getattr(message, field)
            if len(values) == len(message.name):
                for name, value in zip(message.name, values, strict=True):
                    yield f"{topic}/{name}/{field}", float(value)
    elif kind == DIAGNOSTICS_TYPE:
        for status in message.status:
            for entry in status.values:
                name = "/".join(filter(None, (topic, status.hardware_id, status.name, entry.key)))
                try:
                    yield name, float(entry.value)
                except ValueError:
                    continue
    else:
        for name in wanted:
            if name.startswith(f"{topic}/"):
                value = message
                for field in name.removeprefix(f"{topic}/").split("/"):
                    value = getattr(value, field)
                yield name, float(value)


def draw(bag: Path, picture: Path) -> None:
    """Draw every tab of the layout, a column each."""
    import matplotlib.pyplot as plt

    root = ElementTree.parse(LAYOUTS["plotjuggler"]).getroot()
    series = series_of(bag, {str(curve.get("name")) for curve in root.iter("curve")})
    missing = {str(curve.get("name")) for curve in root.iter("curve")} - series.keys()
    if missing:
        sys.exit(f"docs/layouts.py: not in {bag}: {', '.join(sorted(missing))}")
    tabs = root.findall("tabbed_widget/Tab")
    figure = plt.figure(figsize=(19.2, 10.8), dpi=100, layout="constrained")
    for column, tab in zip(figure.subfigures(1, len(tabs)), tabs, strict=True):
        column.suptitle(tab.get("tab_name"), fontweight="bold")
        areas = list(tab.iter("DockArea"))
        splitter = tab.find(".//DockSplitter")
        assert splitter is not None, "a tab has panels"
        sizes = [float(size) for size in str(splitter.get("sizes")).split(";")]
        panels = column.subplots(len(areas), 1, sharex=True, height_ratios=sizes)
        for axes, area in zip(panels, areas, strict=True):
            axes.set_title(area.get("name"), fontsize=9, loc="left")
            for curve in area.iter("curve"):
                name = str(curve.get("name")).removeprefix(f"{NAMESPACE}/")
                scale, transform = 1.0, curve.find("transform")
                if transform is not None:
                    name = str(transform.get("alias"))
                    scale = float(str(transform.find("options").get("value_scale")))
                time, values = np.array(series[str(curve.get("name"))]).T
                axes.plot(time, scale * values, color=curve.get("color"), linewidth=1, label=name)
            axes.legend(loc="best", fontsize=6)
            axes.grid(color="#dddddd")
            axes.tick_params(labelsize=7)
        panels[-1].set_xlabel("s", fontsize=8)
    figure.savefig(picture)


# ----------------------------------------------------------------------------------------------


def keep(picture: Path, name: str) -> None:
    """Write a picture into the docs in few colours."""
    colours = Image.open(picture).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    colours.save(picture_of(name), optimize=True)


def main() -> None:
    """Drive, then show both layouts."""
    limit_blas_threads()
    with TemporaryDirectory() as name:
        folder = Path(name)
        record(folder / "drive")
        draw(folder / "drive", folder / "plotjuggler.png")
        keep(folder / "plotjuggler.png", "plotjuggler")
        photograph(folder / "drive", folder)


if __name__ == "__main__":
    main()
