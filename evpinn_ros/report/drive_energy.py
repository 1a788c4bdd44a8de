"""Energy of a drive over distance: by speed, and running totals of which a stretch is taken."""

from __future__ import annotations

import numpy as np

from evpinn_ros.common.units import Units
from evpinn_ros.energy.power_model import Motion, PowerModel, Weather
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.terms import WARM
from evpinn_ros.replays.driven import DrivenSteps
from evpinn_ros.replays.forecasts import known_model
from evpinn_ros.replays.history import Drive
from evpinn_ros.report.drive_charts import JOULES_PER_WH, Chart
from evpinn_ros.report.thinning import packed
from evpinn_ros.vehicle.files import Vehicle

LEAST_DISTANCE = 100.0  # m in a bin of speed before its energy is shown,
LEAST_SHARE = 0.02  # and so much of the drive: to pass through a speed is not to drive at it
SHOWN_SPEED = 36.0  # m/s: a steady speed is shown up to here however slow the drive was


def speed_energy_chart(drive: Drive, vehicle: Vehicle, steps: DrivenSteps, units: Units) -> Chart:
    """Energy over distance by speed: measured in bins, and at steady speed on a flat road.

    Steps count where they are slow or fast, so what it took to speed up is in the bins on the
    way up, and what braking gave back in the same bins. At a crawl standing load is all there is:
    the first bin is left out.
    """
    width = units.speed_step
    speeds = steps.speed * units.speeds
    bins = np.minimum(speeds / width, 300.0 / width).astype(np.int64)
    energy = np.bincount(bins, steps.energy / JOULES_PER_WH)
    distance = np.bincount(bins, steps.distance / units.metres)
    enough = distance >= max(LEAST_DISTANCE / units.metres, LEAST_SHARE * distance.sum())
    shown = [i for i in np.flatnonzero(enough).tolist() if i > 0]
    last = max([*((i + 1) * width for i in shown), SHOWN_SPEED * units.speeds])
    grid = np.arange(width, last + 1.0)
    car = known_model(drive.model, drive.final, vehicle)
    middle, sigma = _steady_power(car, grid / units.speeds, vehicle.air_density)
    middle, half = (each / JOULES_PER_WH / (grid / 3600.0) for each in (middle, sigma))
    half *= GAUSSIAN_QUANTILE
    return {
        "kind": "bySpeed",
        "axes": [f"speed, {units.speed}", f"Wh/{units.distance}"],
        "width": width,
        "driven": float(speeds.max(initial=0.0)),
        "bars": [[i * width, energy[i] / distance[i], distance[i]] for i in shown],
        "start": float(grid[0]),
        "middle": packed(middle),
        "low": packed(middle - half),
        "high": packed(middle + half),
    }


def running_totals(
    travelled: DrivenSteps, measured: DrivenSteps, duration: float, points: int
) -> Chart:
    """Running totals over time: distance, m, in s; where power was measured distance and J."""
    time = np.linspace(0.0, max(duration, 1.0), points)

    def total(steps: DrivenSteps, values: np.ndarray) -> dict[str, object]:
        if not len(values):
            return packed(np.zeros(points))
        return packed(np.interp(time, steps.end, np.cumsum(values), left=0.0))

    return {
        "step": float(time[1]),
        "distance": total(travelled, travelled.distance),
        "seconds": total(travelled, travelled.seconds),
        "known": total(measured, measured.distance),
        "energy": total(measured, measured.energy),
    }


def _steady_power(
    car: PowerModel, speed: np.ndarray, air_density: float
) -> tuple[np.ndarray, np.ndarray]:
    """Power on a flat road without wind and its 1-sigma, W, at speeds, m/s; shape (n,) each.

    The sigma is as much to be trusted as that of a dropout: one drive without heights seems to
    tell more of slow and fast driving than it does, for its climbs are not random.
    """
    flat, one = np.zeros(len(speed)), np.ones(len(speed))
    warm = Weather(air_density, start=WARM)
    rows = car.rows(Motion(one, speed, speed**3, flat, flat), warm)
    variance = car.car.trust * ((rows @ car.car.covariance) * rows).sum(-1)
    return rows @ car.car.mean, np.sqrt(variance)
