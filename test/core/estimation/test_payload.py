"""Payload of a drive against the drive before it: told beyond chance alone."""

from dataclasses import replace

import pytest

from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.payload import Payload
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.reorder import in_order
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, simulate

SECONDS = 900


def driven(vehicle, loads) -> Payload:
    """Payload of the last of some drives in town, each with so many kg more than the first."""
    learned, car = LearnedCar.new(equation_of(vehicle)), None
    for number, load in enumerate(loads):
        loaded = car and replace(car, mass=car.mass + load)
        start_ns = EPOCH_NS + number * 86_400 * NANOSECONDS
        drive = simulate(
            DriveKind.URBAN, vehicle, SECONDS, 3000 + number, car=loaded, start_ns=start_ns
        )
        car = car or drive.car
        stream = SampleStream(StreamSettings(), vehicle.air_density, vehicle.motor_ratio)
        intervals = stream.add(in_order(Block.of(drive.readings))).intervals
        learned = learned.begin_drive().after(interval for _, interval in intervals)
    return learned.payload


@pytest.mark.parametrize("load", [400.0, -400.0])
def test_a_load_that_came_or_went_is_told_with_its_begin(vehicle, load):
    before = (0.0, 0.0) if load > 0.0 else (-load, -load)
    change = driven(vehicle, (*before, load if load > 0.0 else 0.0)).change
    assert change is not None
    assert change.delta_mass == pytest.approx(load, abs=3.0 * change.std)
    assert abs(change.delta_mass) > 3.0 * change.std > 0.0
    assert change.stamp_ns >= EPOCH_NS + 2 * 86_400 * NANOSECONDS


def test_no_load_is_told_where_none_came(vehicle):
    payload = driven(vehicle, (0.0, 0.0, 0.0))
    assert payload.before is not None and payload.change is None
