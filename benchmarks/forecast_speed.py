"""Speed of forecasts of many profiles, in numpy and in torch."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.energy.forecast import Profiles, forecast
from evpinn_ros.energy.power_model import vehicle_model
from evpinn_ros.vehicle.files import Vehicle

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


def _quickest_ms(work: Callable[[], Any]) -> float:
    times = []
    for _ in range(REPEATS):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return 1e3 * min(times)
