"""The car as published, and the drives of the estimator's tests."""

import pytest

from evpinn_ros.vehicle.files import Vehicle, load_vehicle
from test.estimation.conftest import synthetic  # noqa: F401

pytestmark = pytest.mark.torch


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("tesla_model_3_lr").as_published
