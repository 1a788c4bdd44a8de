"""`evpinn bench speed`: times replays and forecasts, in the library and over DDS."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer

from benchmarks.cli.output import figures_table, json_as_it_comes
from evpinn_ros.api.recordings import replay
from evpinn_ros.cli.console import note, progress_bar, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.core.energy.forecast import Profiles, forecast
from evpinn_ros.core.energy.power_model import vehicle_model
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.output import write
from evpinn_ros.replays.simulation.simulate import simulate

BATCH, POINTS = 1000, 600
REPEATS = 3


class ForecastThroughput(NamedTuple):
    """Milliseconds of the processor for `BATCH` profiles of `POINTS` points, the quickest run."""

    vehicle_file_ms: float
    learned_ms: float
    torch_ms: float
    torch_gradient_ms: float


def measure_throughput(vehicle: Vehicle) -> ForecastThroughput:
    """Time the library in the calling thread alone."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    profiles = hilly_profiles(BATCH, POINTS)
    learned = vehicle_model(vehicle)
    tensors = Profiles(*(torch.as_tensor(array) for array in profiles))

    def gradient() -> None:
        speed = tensors.speed.clone().requires_grad_()
        energy, sigma = forecast(tensors._replace(speed=speed), vehicle, learned)
        (energy + sigma).sum().backward()

    try:
        return ForecastThroughput(
            _quickest_ms(lambda: forecast(profiles, vehicle)),
            _quickest_ms(lambda: forecast(profiles, vehicle, learned)),
            _quickest_ms(lambda: forecast(tensors, vehicle, learned)),
            _quickest_ms(gradient),
        )
    finally:
        torch.set_num_threads(threads)


def hilly_profiles(batch: int, points: int) -> Profiles:
    """Candidates like an optimiser's: one trip over hills, driven in many ways."""
    random = np.random.default_rng(0)
    time_s = np.arange(float(points))
    basis = np.sin(np.outer(np.arange(1, 9), time_s) * np.pi / 120.0)
    speed = 15.0 + random.normal(0.0, 2.0, (batch, 8)) @ basis
    speed = np.clip(speed, 0.0, 38.0)
    return Profiles(time_s, speed, 20.0 * np.sin(np.cumsum(speed, axis=1) / 700.0))


class ReplayThroughput(NamedTuple):
    """A replay with learning, by the processor time of its quickest run.

    Attributes:
        realtime_factor: seconds of the drive for each of the processor.
        sample_us: microseconds per speed, with all readings between two speeds.
        kalman_us: the same for a step of an extended Kalman filter of six states, in numpy.
    """

    realtime_factor: float
    sample_us: float
    kalman_us: float


def measure_replay(vehicle: Vehicle, seconds: float) -> ReplayThroughput:
    """Time the replay of a simulated drive from its bag, and a Kalman filter beside it."""
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "drive"
        write(simulate(DriveKind.MIXED, vehicle, seconds, seed=1), bag)
        speeds = len(replay(bag, vehicle).replayed.drive.speed)
        took_ms = _quickest_ms(lambda: replay(bag, vehicle))
    kalman_ms = _quickest_ms(lambda: _kalman_steps(speeds))
    return ReplayThroughput(
        1e3 * seconds / took_ms, *(1e3 * ms / speeds for ms in (took_ms, kalman_ms))
    )


def _kalman_steps(count: int) -> None:
    """Run an extended Kalman filter of the six parameters on powers of eq. 21."""
    state, covariance, noise = np.ones(6), np.eye(6), 1e-6 * np.eye(6)
    for step in range(count):
        speed = 10.0 + step % 10
        gradient = np.array([speed**3, speed, speed * (step % 3 - 1.0), speed, 1.0, -1.0])
        covariance = covariance + noise
        along = covariance @ gradient
        gain = along / (gradient @ along + 1e4)
        state = state + gain * (1e3 - gradient @ state)
        covariance = covariance - np.outer(gain, along)


def _quickest_ms(work: Callable[[], Any]) -> float:
    times = []
    for _ in range(REPEATS):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return 1e3 * min(times)


TOGETHER = 12  # plans
CAR = "tesla_model_3_lr"


def speed(
    plans: Annotated[int, typer.Option(min=10, help="Plans asked for over DDS.")] = 1000,
    seconds: Annotated[float, typer.Option(min=60, help="Length of the replayed drive.")] = 1800.0,
    live: Annotated[int, typer.Option(min=5, help="Seconds of driving through the nodes.")] = 30,
    json_file: JsonOption = None,
) -> None:
    """Time replays and forecasts: a drive, many profiles at once, plans asked of `energy`.

    The replay reads a simulated drive at 10 Hz from its bag and learns; an extended Kalman filter
    of six states is timed beside it. The library is timed in numpy and torch, as processor time.
    The nodes are timed from a plan to its answer, for single plans and for twelve together with
    all their differences; from a call of the typed service to its answer, if `evpinn_msgs` is
    installed; and from a reading to the topics, beside a node that answers at once. The memory of
    the three nodes is measured too. `evpinn bench plans` measures how accurate forecasts are.

    Example: evpinn bench speed --plans 300
    """
    limit_blas_threads()
    figures: dict[str, Any] = {"load_average": os.getloadavg()[0]}
    with json_as_it_comes(json_file, lambda: figures) as keep:
        figures["replay"] = _replay(seconds)
        keep()
        figures["library"] = _library()
        keep()
        if find_spec("rclpy") is None:
            note("rclpy is not installed: plans over DDS are left out")
        else:
            figures["plans"] = _plans(plans)
            keep()
            figures["live"] = _live(plans, live)


def _replay(seconds: float) -> dict[str, float]:
    load = measure_replay(load_vehicle(CAR), seconds)
    rows = [
        ("times real time", f"{load.realtime_factor:.0f}", "1000"),
        ("a sample", f"{load.sample_us:.0f} us", "90 us"),
        ("a step of a Kalman filter", f"{load.kalman_us:.0f} us", ""),
        ("  replay over that", f"{load.sample_us / load.kalman_us:.0f}", "10"),
    ]
    show(figures_table(f"Replay of {seconds:.0f} s at 10 Hz with learning, one core", rows))
    return load._asdict()


def _library() -> dict[str, float]:
    throughput = measure_throughput(load_vehicle(CAR))
    rows = [
        ("vehicle file, numpy", f"{throughput.vehicle_file_ms:.0f} ms", "100 ms"),
        ("learned model, numpy", f"{throughput.learned_ms:.0f} ms", "100 ms"),
        ("learned model, torch", f"{throughput.torch_ms:.0f} ms", ""),
        ("  with the gradient", f"{throughput.torch_gradient_ms:.0f} ms", ""),
    ]
    show(figures_table(f"{BATCH} profiles of {POINTS} points, one core", rows))
    return throughput._asdict()


def _plans(plans: int) -> dict[str, Any]:
    # Imported here: the rest works where no ROS is.
    from benchmarks.plan_load import measure_plans, measure_rounds

    with progress_bar("plans", total=plans, unit="plans") as progress:
        load = measure_plans(plans, POINTS, progress)
    rows = [
        ("p50", f"{load.p50_ms:.1f} ms", ""),
        ("p99", f"{load.p99_ms:.1f} ms", "20 ms"),
        ("largest", f"{load.largest_ms:.1f} ms", ""),
        ("the node's processor", f"{load.node_ms:.1f} ms", ""),
    ]
    show(
        figures_table(
            f"A plan of {POINTS} points, request to answer over DDS, {plans} times", rows
        )
    )
    with progress_bar("rounds", total=plans // 10, unit="rounds") as progress:
        rounds = measure_rounds(max(plans // 10, 1), TOGETHER, POINTS, progress)
    rows = [
        (f"{TOGETHER} plans, p50", f"{rounds.p50_ms:.1f} ms", ""),
        (f"{TOGETHER} plans, p99", f"{rounds.p99_ms:.1f} ms", "60 ms"),
        ("a refusal, p50", f"{rounds.refusal_p50_ms:.1f} ms", ""),
        ("a refusal, p99", f"{rounds.refusal_p99_ms:.1f} ms", "100 ms"),
    ]
    show(figures_table(f"Plans asked together, with all differences, {rounds.rounds} times", rows))
    return {**load._asdict(), "together": rounds._asdict()}


RATE, INPUTS = 200.0, 10.0  # Hz of speed and battery: through the nodes; while plans are asked


def _live(calls: int, seconds: int) -> dict[str, Any]:
    from benchmarks.node_load import Delay, measure_calls, measure_memory, measure_topics
    from evpinn_ros.nodes.factory import is_installed
    from evpinn_ros.nodes.typed import PACKAGE

    figures: dict[str, Any] = {}
    rows = []

    def add(name: str, ours: Delay, floor: Delay, goals: tuple[str, str]) -> None:
        figures[name] = {"nodes": ours._asdict(), "floor": floor._asdict()}
        for quantile, goal in zip(("p50_ms", "p99_ms"), goals, strict=True):
            measured = f"{getattr(ours, quantile):.1f} ms ({getattr(floor, quantile):.1f})"
            rows.append((f"{name}, {quantile[:3]}", measured, goal))

    with progress_bar("driving", total=2 * seconds, unit="s") as progress:
        ours = measure_topics(RATE, seconds, progress)
        floor = measure_topics(RATE, seconds, lambda s: progress(seconds + s), floor=True)
    for name, goals in GOALS.items():
        add(name, ours[name], floor[name], goals)
    if is_installed(PACKAGE):
        for points in (3, POINTS):
            with progress_bar(
                f"calls of {points} points", total=2 * calls, unit="calls"
            ) as progress:
                ours_call = measure_calls(points, calls, INPUTS, progress)
                floor_call = measure_calls(points, calls, INPUTS, progress, floor=True)
            add(f"service, {points} points", ours_call, floor_call, ("4 ms", "15 ms"))
    else:
        note(f"{PACKAGE} is not installed: calls of its service are left out")
    memory = measure_memory(seconds)
    figures["memory_mb"] = memory
    rows.append(("memory of three nodes", f"{sum(memory.values()):.0f} MB", "260 MB"))
    show(figures_table(f"{RATE:.0f} speeds a second (a node that answers at once)", rows))
    return figures


GOALS = {
    "power/predicted": ("3 ms", "20 ms"),
    "power/measured": ("3 ms", ""),
    "energy/state": ("", ""),
}
