"""The picture of docs/guides/planning.md: what the planner asks, what the energy node answers.

Run: python docs/eco_speed.py (`make docs` does)
"""

from collections.abc import Callable, Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import sys
import time
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

from evpinn_ros import topics
from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.parameters import overrides
from evpinn_ros.report.figure import save_figure
from evpinn_ros.topics import Topic
from evpinn_ros.topics.energies import output_messages

ROOT = Path(__file__).resolve().parents[1]
VEHICLE, DRIVE = "tesla_model_3_lr", "urban"
HEARD = (topics.IDENTIFIABLE, topics.POWER_SMOOTHED)  # what the energy node learns the car from
PICK, IN_TIME, LATE = "tab:orange", "tab:blue", "0.5"
STEADY, HILLS = "steady", "with the hills"
DIP = 5.7  # km, before the second hill: there speeds lie apart
BEFORE = {"fmt": "o", "ms": 3, "elinewidth": 1, "alpha": 0.5}
AFTER = {"fmt": "o", "ms": 5, "elinewidth": 3}
OUTSIDE = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
SMALL = {"fontsize": "small", "annotation_clip": False}
BESIDE = {"xycoords": ("axes fraction", "data"), "va": "center", **SMALL}
ABOVE = {"xytext": (0, 2), "textcoords": "offset points", "ha": "right", **SMALL}
ABOVE |= {"xycoords": ("axes fraction", "data")}
BELOW = {"xytext": (0, -2), "textcoords": "offset points", "ha": "center", "va": "top", **SMALL}
BELOW |= {"bbox": {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none"}}
TIMEOUT = 30.0  # s
WH = 3600.0


def load_example() -> Any:
    """The example as a module."""
    path = ROOT / "examples" / "eco_speed_planner.py"
    spec = spec_from_file_location("eco_speed_planner", path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def drive_messages() -> Iterator[tuple[Topic, Any]]:
    """Outputs of the estimator during a bundled drive."""
    worker = InlineWorker(time.perf_counter)
    estimator = OnlineEstimator(load_vehicle(VEHICLE), EstimatorSettings(), worker)
    with BagReader(share_directory() / "bags" / DRIVE) as bag:
        for reading in BagReadings(bag):
            for output in estimator.add_readings([reading]):
                for topic, message in output_messages(new_message, output):
                    if topic in HEARD:
                        yield topic, message


def asked_twice(example: Any) -> tuple[Any, list[Any], list[Any]]:
    """The planner, its answers before the car was driven, and those after."""
    executor = SingleThreadedExecutor()
    energy = EnergyNode(parameter_overrides=overrides({"vehicle": VEHICLE}))
    planner = example.EcoSpeedPlanner(parameter_overrides=overrides({"period": 1.0}))
    driver = rclpy.create_node("driver")
    publishers = {topic: factory.advertise(driver, topic) for topic in HEARD}
    for node in (energy, planner, driver):
        executor.add_node(node)

    def wait(condition: Callable[[], bool]) -> None:
        while not condition():
            executor.spin_once(timeout_sec=TIMEOUT)

    def answered() -> bool:
        return all(answer.complete and not answer.refusal for answer in planner.answers)

    wait(answered)
    before = planner.answers
    for topic, message in drive_messages():
        count = energy.received[topic]
        publishers[topic].publish(message)
        wait(lambda topic=topic, count=count: energy.received[topic] > count)
    during = planner.answers
    wait(lambda: planner.answers is not during and answered())
    return planner, before, planner.answers


def draw_route(axes: Axes, planner: Any, pick: int, deadline: float) -> None:
    """Speeds over distance, each named: steady ones beside, the others in a dip; and the hills."""
    road = planner.candidates[0]
    hills = axes.twinx()
    hills.fill_between(road.distance / 1000, road.elevation, color="tab:green", alpha=0.15, lw=0)
    hills.set(ylim=(0, 2.5 * road.elevation.max()), yticks=(0, 50, 100))
    hills.set_ylabel("elevation, m", loc="bottom")
    for index, candidate in enumerate(planner.candidates):
        colour = _colour(index, candidate, pick, deadline)
        steady = candidate.name.endswith(STEADY)
        style = {"color": colour, "ls": "--" if steady else "-", "lw": 3.0 if index == pick else 1}
        distance, speed = candidate.distance / 1000, candidate.speed * 3.6
        axes.plot(distance, speed, zorder=style["lw"], **style)
        name = candidate.name.removesuffix(STEADY if steady else HILLS)
        if steady:
            axes.annotate(name, (1.01, speed.max()), **BESIDE, color=colour)
        else:
            dip = int(np.argmin(np.where(np.abs(distance - DIP) < 1.0, speed, np.inf)))
            axes.annotate(name.partition(" ")[0], (DIP, speed[dip]), **BELOW, color=colour)
    axes.set(ylabel="speed, km/h", xlim=(0, road.distance[-1] / 1000), ylim=(0, 100))
    axes.set_xlabel("distance, km")
    lines = [
        Line2D([], [], color=PICK, lw=3, label="picked"),
        Line2D([], [], color=IN_TIME, label="in time"),
        Line2D([], [], color=LATE, label="late"),
        Line2D([], [], color="k", ls="--", lw=1, label=STEADY),
        Line2D([], [], color="k", lw=1, label=HILLS),
    ]
    axes.legend(handles=lines, **OUTSIDE, ncols=len(lines))


def draw_energies(axes: Axes, order: list[int], asked: list[Any], colours: list[str]) -> None:
    """Energy of each profile with its band, before and after the car was driven."""
    for answers, offset, style in zip(asked, (0.2, -0.15), (BEFORE, AFTER), strict=True):
        for row, index in enumerate(order):
            half = GAUSSIAN_QUANTILE * answers[index].sigma / WH
            energy = answers[index].energy / WH
            axes.errorbar(energy, row + offset, xerr=half, color=colours[index], **style)
    axes.set_xlabel("energy, Wh, with its 90 % band")
    drawn = [
        axes.errorbar([], [], xerr=[], color=IN_TIME, label=label, **style)
        for label, style in (("by the vehicle file", BEFORE), ("after 6 min of driving", AFTER))
    ]
    axes.legend(handles=drawn, **OUTSIDE, ncols=2)


def draw_differences(axes: Axes, order: list[int], more: list[Any], colours: list[str]) -> None:
    """Energy of each profile beyond that of the picked one, whose errors they share."""
    for row, index in enumerate(order):
        apart, sigma = (joules / WH for joules in more[index])
        half = GAUSSIAN_QUANTILE * sigma
        axes.errorbar(apart, row, xerr=half, color=colours[index], **AFTER)
        text = f"{apart:+.0f} ± {sigma:.0f}" if sigma else "picked"
        axes.annotate(text, (1.02, row), **BESIDE, color=colours[index])
    axes.axvline(0.0, color="k", lw=1, zorder=0)
    axes.set_xlabel("more than the picked one, Wh, with its 90 % band")
    axes.annotate("± 1-sigma, Wh", (1.02, len(order)), **BESIDE)


def name_rows(axes: Axes, planner: Any, order: list[int], deadline: float) -> None:
    """Each row by its profile and arrival, in order of arrival, and where the deadline is."""
    arrivals = [planner.candidates[index].arrival for index in order]
    names = [
        f"{planner.candidates[index].name}, {arrival // 60:.0f}:{arrival % 60:02.0f}"
        for index, arrival in zip(order, arrivals, strict=True)
    ]
    axes.set_yticks(range(len(order)), names)
    axes.set_ylim(len(order) - 0.4, -0.6)
    late = sum(arrival <= deadline for arrival in arrivals) - 0.5
    for axis in axes.figure.axes[-2:]:
        axis.axhline(late, color="k", ls="--", lw=1)
    axes.annotate(f"deadline {deadline / 60:g} min", (0.99, late), **ABOVE)


def _colour(index: int, candidate: Any, pick: int, deadline: float) -> str:
    return PICK if index == pick else LATE if candidate.arrival > deadline else IN_TIME


def main() -> None:
    """Write the picture beside this file."""
    limit_blas_threads()
    example = load_example()
    rclpy.init()
    try:
        planner, before, after = asked_twice(example)
        deadline = planner.get_parameter("deadline").value
    finally:
        rclpy.try_shutdown()
    pick = example.cheapest_in_time(planner.candidates, after, deadline)
    candidates = planner.candidates
    colours = [_colour(i, candidate, pick, deadline) for i, candidate in enumerate(candidates)]
    order = sorted(range(len(candidates)), key=lambda index: candidates[index].arrival)
    more = [example.difference(after, index, pick) for index in range(len(candidates))]
    figure = Figure(figsize=(11, 8.5), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(1, 1.1))
    draw_route(figure.add_subplot(grid[0, :]), planner, pick, deadline)
    energies = figure.add_subplot(grid[1, 0])
    differences = figure.add_subplot(grid[1, 1], sharey=energies)
    differences.tick_params(labelleft=False)
    draw_energies(energies, order, [before, after], colours)
    draw_differences(differences, order, more, colours)
    name_rows(energies, planner, order, deadline)
    for axes in (energies, differences):
        axes.grid(alpha=0.3)
    save_figure(figure, Path(__file__).with_name("eco_speed.png"))


if __name__ == "__main__":
    main()
