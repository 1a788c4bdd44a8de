"""A sensor that hangs: nothing is learned from it, and a stuck battery is not measured."""

from bisect import bisect_right
from copy import deepcopy
from dataclasses import replace
import math
from pathlib import Path

import pytest

from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.estimator import OnlineEstimator
from evpinn_ros.core.signals.detector import BATTERY_STUCK, SPEED_REPEATS, SPEED_STUCK
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.core.signals.stuck import Verdict
from evpinn_ros.core.vehicle.files import load_vehicle

FROM, UNTIL = 5.0, 20.0  # s


@pytest.mark.parametrize("stuck", [SPEED_STUCK, BATTERY_STUCK])
def test_a_stuck_sensor_teaches_nothing(new_estimator, stuck):
    estimator, kinds = new_estimator(), []
    for step in range(round(10 * UNTIL)):
        now = step / 10
        speed, current = 14 + 8 * math.sin(now / 3), -60 - 150 * math.cos(now / 3)
        if now > FROM:
            speed = 15.0 if stuck == SPEED_STUCK else speed
            current = -40.0 if stuck == BATTERY_STUCK else current
        stamp_ns = NANOSECONDS + round(now * NANOSECONDS)
        for reading in (BatteryReading(stamp_ns, 350.0, current), SpeedReading(stamp_ns, speed)):
            outputs = estimator.add_readings([reading])
            kinds += [(now, o.kind) for o in outputs if isinstance(o, PowerEstimate)]
    status = estimator.status()
    assert status.stuck == stuck and status.gated[stuck] > 20
    late = {kind for now, kind in kinds if now > UNTIL - 5.0}
    assert {PowerKind.PREDICTED, PowerKind.SMOOTHED} <= late
    assert (PowerKind.MEASURED in late) == (stuck == SPEED_STUCK)


URBAN = Path(__file__).resolve().parents[3] / "bags" / "urban"


def mass_over_eta(estimator):
    return estimator.parameters().identifiable.mass_over_eta


@pytest.fixture(scope="module")
def readings() -> list[Reading]:
    from evpinn_ros.logs.sources import open_source  # `make core` has not what reads a bag

    return list(open_source(URBAN, load_vehicle("tesla_model_3_lr")).readings())


@pytest.fixture(scope="module")
def undisturbed(readings, new_estimator) -> dict[float, OnlineEstimator]:
    """Cars that learned from the first 60 and the first 75 s of the drive."""
    estimator = new_estimator()
    seconds = [(reading.stamp_ns - readings[0].stamp_ns) / NANOSECONDS for reading in readings]
    first, cars = 0, {}
    for until in (60.0, 75.0):
        last = bisect_right(seconds, until)
        estimator.add_readings(readings[first:last])
        first, cars[until] = last, deepcopy(estimator)
    return cars


@pytest.mark.slow
@pytest.mark.parametrize(
    ("begin", "value", "most"), [(60.0, None, 0.005), (75.0, None, 0.005), (60.0, 17.0, 0.02)]
)
def test_a_speed_that_hangs_for_seconds_moves_next_to_nothing(
    readings, undisturbed, begin, value, most
):
    """From the moment it hangs, at the last value or another, until a second after it moved again.

    Against the same seconds with a silent battery, of which nothing is learned. When only what was
    suspected was left out, and what lay behind was learned once it was not, this was up to 6 %.
    """
    estimators = []
    for hangs in (False, True):
        estimator, held = deepcopy(undisturbed[begin]), value
        given: list[Reading] = []
        for reading in readings:
            now = (reading.stamp_ns - readings[0].stamp_ns) / NANOSECONDS
            if not begin < now <= begin + 9.0:
                continue
            disturbed = now < begin + 8.0
            if disturbed and not hangs and isinstance(reading, BatteryReading):
                continue
            if disturbed and hangs and isinstance(reading, SpeedReading):
                held = reading.speed if held is None else held
                reading = replace(reading, speed=held)
            given.append(reading)
        estimator.add_readings(given)
        estimator.flush()
        estimators.append(estimator)
    silent, hung = map(mass_over_eta, estimators)
    assert abs(hung / silent - 1.0) < most
    gated = estimators[1].status().gated
    assert any(gated.get(why) for why in (SPEED_STUCK, SPEED_REPEATS))


@pytest.mark.slow
def test_a_speed_that_hangs_leaves_no_hole_in_the_energy_of_a_silent_battery(
    readings, new_estimator, monkeypatch
):
    """Where no battery is measured nothing is learned that a doubtful speed could spoil.

    A third of the energy of a first drive was missing when its intervals were left out.
    """
    energies = []
    for doubts in (True, False):
        estimator = new_estimator()
        if not doubts:
            monkeypatch.setattr(Verdict, "why_not", lambda *_: None)
        for reading in readings:
            now = (reading.stamp_ns - readings[0].stamp_ns) / NANOSECONDS
            if (isinstance(reading, BatteryReading) and now > 2.0) or now > 80.0:
                continue
            if isinstance(reading, SpeedReading) and 60.0 < now < 68.0:
                reading = replace(reading, speed=12.0)
            for output in estimator.add_readings([reading]):
                if getattr(output, "kind", None) is PowerKind.SMOOTHED:
                    energy = output.energy
        energies.append(energy)
    assert energies[0] == energies[1] > 1e5
