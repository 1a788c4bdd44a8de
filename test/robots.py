"""The simulated robot of the examples, for tests: its drives, and what it truly takes."""

from collections.abc import Iterator
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
import math
import sys
from typing import Any

import numpy as np

import evpinn_ros as ev
from evpinn_ros.core.energy.plan import Plan
from test.conftest import ROOT

NAME = "simulated_robot"


@cache
def robot() -> Any:
    """The example as a module."""
    if NAME not in sys.modules:
        spec = spec_from_file_location(NAME, ROOT / "examples" / f"{NAME}.py")
        assert spec is not None and spec.loader is not None
        sys.modules[NAME] = module_from_spec(spec)
        spec.loader.exec_module(sys.modules[NAME])
    return sys.modules[NAME]


def moments(seed: int, seconds: float) -> Iterator[Any]:
    """Moments of a drive from its start on."""
    for now in robot().drive(seed):
        if now.time > seconds:
            return
        yield now


def true_energy(plan: Plan) -> float:
    """Energy that the robot takes for a plan, J, without what it plans and turns meanwhile."""
    ours = robot()
    time = np.arange(0.0, plan.time[-1], ours.STEP)
    energy = before = 0.0
    for speed in np.interp(time, plan.time, plan.speed).tolist():
        energy += ours.STEP * (ours.COMPUTER + ours.motor_power(speed, before))
        before = speed
    return energy


@cache
def learned(seed: int, minutes: float = 10.0) -> ev.Estimator:
    """What the robot taught in so many minutes."""
    estimator = ev.Estimator("mobile_robot")
    for now in moments(seed, 60.0 * minutes):
        battery = (now.voltage, now.current) if now.battery_due else (math.nan, math.nan)
        charge = 100.0 * now.charge if now.battery_due else math.nan
        estimator.add(now.time, now.speed, *battery, soc_pct=charge)
    return estimator
