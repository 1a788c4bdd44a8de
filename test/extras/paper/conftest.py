"""A drive that obeys eq. 21, small enough to train on in a test; drives of the estimator."""

from functools import cache

import numpy as np
import pytest

from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import RegenForm, battery_power
from evpinn_ros.extras.paper.drive_log import DriveLog
from evpinn_ros.extras.paper.experiment import Experiment
from evpinn_ros.extras.paper.settings import Settings
from test.core.estimation.conftest import synthetic  # noqa: F401

pytestmark = pytest.mark.torch

TRUE = Parameters(eta=0.82, mu=0.74, mass=1950.0, c_rr=0.0088, c_d=0.24, p_aux=900.0)
PERIOD = 0.1  # s


@pytest.fixture(scope="session")
def vehicle():
    return load_vehicle("tesla_model_3_lr").as_published


@pytest.fixture(scope="session")
def make_log(vehicle):
    """A log of given speed, m/s, at 10 Hz; 40 s of stop and go if none."""

    def make(speed=None, form=RegenForm.RECOVERY, noise=50.0, seed=0):
        if speed is None:
            time = PERIOD * np.arange(400)
            wave = 12.0 + 9.0 * np.sin(0.45 * time) + 6.0 * np.sin(1.1 * time + seed)
            speed = np.maximum(wave, 0.0)
        time = PERIOD * np.arange(len(speed))
        acceleration = np.gradient(speed, PERIOD)
        power = battery_power(
            speed,
            acceleration,
            TRUE,
            area=vehicle.frontal_area,
            air_density=vehicle.air_density,
            form=form,
            beta=vehicle.beta,
        )
        power = power + noise * np.random.default_rng(seed).standard_normal(len(speed))
        return DriveLog(time, speed, acceleration, power)

    return make


@pytest.fixture(scope="session")
def reproduced(make_log, vehicle, tmp_path_factory):
    """A short experiment on that drive."""

    @cache
    def run(name):
        settings = Settings(name, epochs=30, energy_epochs=20)
        folder = tmp_path_factory.mktemp("experiment")
        return Experiment(make_log(), vehicle, settings, folder).run(lambda *_: None)

    return run
