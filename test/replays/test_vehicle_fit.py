"""A log of another car than the vehicle file's is said to be one."""

from dataclasses import replace

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.identifiable import prior_identifiable
from evpinn_ros.replays.history import Drive, History
from evpinn_ros.replays.vehicle_fit import vehicle_doubt

I3 = load_vehicle("bmw_i3")


def drive(mass_over_eta: float, std: float = 60.0, kwh: float = 0.0, used: float = 0.0) -> Drive:
    """A drive of an hour at even power, from which so much was learned."""
    time = np.arange(0.0, 3601.0)
    power = np.full(len(time), kwh * JOULES_PER_KWH / 3600.0)
    charge = np.array([[0.0, 0.9], [3600.0, 0.9 - used]])
    return replace(
        History().drive(),
        combinations={"mass_over_eta": np.array([[3600.0, mass_over_eta, std]])},
        speed=np.column_stack((time, np.full(len(time), 15.0))),
        measured=np.column_stack((time, power)),
        charge=charge,
        duration=3600.0,
    )


def test_a_car_as_its_file_says_is_not_doubted():
    expected = float(prior_identifiable(I3)[0].mass_over_eta)
    capacity = I3.battery_capacity / JOULES_PER_KWH
    assert vehicle_doubt(I3, drive(expected)) is None
    assert vehicle_doubt(I3, drive(expected, kwh=0.3 * capacity, used=0.3)) is None
    assert vehicle_doubt(I3, drive(expected, kwh=0.2 * 46.0, used=0.01)) is None


def test_a_heavier_car_is_named_with_rivals_of_its_mass():
    text = vehicle_doubt(I3, drive(2280.0))
    assert text is not None and text.startswith(f"This log does not look like a {I3.name}: mass")
    assert "2280 kg" in text and "--vehicle generic, or one of " in text


def test_a_larger_battery_shows_by_charge_and_energy():
    expected = float(prior_identifiable(I3)[0].mass_over_eta)
    text = vehicle_doubt(I3, drive(expected, kwh=0.2 * 46.0, used=0.2))
    assert text is not None and "its battery holds 46 kWh by charge and energy" in text
