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
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

from evpinn_ros import topics
from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.parameters import overrides
from evpinn_ros.report.figure import save_figure
from evpinn_ros.topics import Topic
from evpinn_ros.topics.estimates import output_messages
from evpinn_ros.vehicle.files import load_vehicle

ROOT = Path(__file__).resolve().parents[1]
VEHICLE, DRIVE = "tesla_model_3_lr", "urban"
HEARD = (topics.IDENTIFIABLE, topics.POWER_SMOOTHED)  # what the energy node learns the car from
PICK, IN_TIME, LATE = "tab:orange", "tab:blue", "0.6"
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
            for output in estimator.add_reading(reading):
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
        return bool(np.isfinite([answer.energy for answer in planner.answers]).all())

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
    """Speeds over distance, and the hills below them."""
    road = planner.candidates[0]
    hills = axes.twinx()
    hills.fill_between(road.distance / 1000, road.elevation, color="tab:green", alpha=0.15, lw=0)
    hills.set_ylim(0, 2.5 * road.elevation.max())
    hills.set_ylabel("elevation, m")
    for index, candidate in enumerate(planner.candidates):
        colour, width, label = _style(index, candidate, pick, deadline)
        distance, speed = candidate.distance / 1000, candidate.speed * 3.6
        axes.plot(distance, speed, color=colour, lw=width, zorder=width, label=label)
    axes.set(xlabel="distance, km", ylabel="speed, km/h", xlim=(0, road.distance[-1] / 1000))
    axes.set_ylim(0, None)
    # A candidate of each kind stands for all.
    labels = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    axes.legend(labels.values(), labels.keys(), loc="lower center", ncols=3)


def draw_energies(
    axes: Axes, planner: Any, before: list[Any], after: list[Any], pick: int, deadline: float
) -> None:
    """Energy over arrival with bands, before and after the car was driven."""
    for index, candidate in enumerate(planner.candidates):
        colour, _, _ = _style(index, candidate, pick, deadline)
        minutes = candidate.arrival / 60
        for answer, width, alpha in ((before[index], 1.5, 0.4), (after[index], 5.0, 1.0)):
            half = GAUSSIAN_QUANTILE * answer.sigma / WH
            style = {"color": colour, "alpha": alpha, "elinewidth": width}
            axes.errorbar(minutes, answer.energy / WH, half, fmt="o", ms=2 + width, **style)
    axes.axvline(deadline / 60, color="k", ls="--", lw=1)
    top = axes.get_xaxis_transform()
    axes.text(deadline / 60, 0.98, " deadline", va="top", transform=top)
    axes.set(xlabel="arrival, min", ylabel="energy, Wh")
    axes.set_title(
        "Forecast with its 90 % band: thin, by the vehicle file; thick, after 6 min of driving",
        fontsize="medium",
    )


def _style(index: int, candidate: Any, pick: int, deadline: float) -> tuple[str, float, str]:
    if index == pick:
        return PICK, 3.0, "picked"
    if candidate.arrival > deadline:
        return LATE, 1.0, "late"
    return IN_TIME, 1.2, "in time"


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
    figure = Figure(figsize=(10, 7), layout="constrained")
    route, energies = figure.subplots(2, 1)
    draw_route(route, planner, pick, deadline)
    draw_energies(energies, planner, before, after, pick, deadline)
    for axes in (route, energies):
        axes.grid(alpha=0.3)
    save_figure(figure, Path(__file__).with_name("eco_speed.png"))


if __name__ == "__main__":
    main()
