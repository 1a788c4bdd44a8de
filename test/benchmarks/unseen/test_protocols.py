"""What is withheld stays withheld, and a method that knows all has no error."""

import copy
import math

import numpy as np
import pytest

from benchmarks.unseen.drives import UnseenDrive
from benchmarks.unseen.lines import DrivePart
from benchmarks.unseen.method import OnlineChain, Prediction
from benchmarks.unseen.protocols import cuts, predicted, run_car
from benchmarks.unseen.scores import score_part
from benchmarks.unseen.summary import summary
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading

START_NS = 1_700_000_000 * NANOSECONDS


class Oracle:
    """Knows the power, with an error that is `bias` W for ever and a sigma of energy."""

    def __init__(self, power, bias=0.0, sigma=0.0):
        self.power, self.bias, self.sigma = power, bias, sigma

    def add_reading(self, reading):
        if isinstance(reading, SpeedReading):
            time = (reading.stamp_ns - START_NS) / NANOSECONDS
            power = float(self.power(np.array([time]))[0]) + self.bias
            yield Prediction(reading.stamp_ns, power, energy_sigma=self.sigma)

    def begin_next_drive(self):
        pass

    def combinations(self):
        return {}


class Forked(Oracle):
    """Its copies go on without the battery, so none of them may ever see a battery reading."""

    is_copy = False
    copies = 0

    def __deepcopy__(self, memo):
        Forked.copies += 1
        copy = Forked(self.power)
        copy.is_copy = True
        return copy

    def add_reading(self, reading):
        assert not (self.is_copy and isinstance(reading, BatteryReading)), "a battery reading"
        return super().add_reading(reading)


def test_no_copy_of_a_method_ever_gets_a_battery_reading(car, true_power):
    Forked.copies = 0
    run = run_car(car, lambda vehicle: Forked(true_power))
    drives = len(car.drives)
    assert len(run.carried) == drives
    # One copy a drive that is carried, and one at each moment where the battery is cut.
    moments = sum(len({cut.begin for cut in cuts(drive, 50.0)}) for drive in car.drives)
    assert Forked.copies == drives + moments


def test_a_later_battery_changes_nothing_that_is_predicted(car, vehicle):
    """The current tripled after the cut: the prediction of our own estimator stays to the bit."""
    drive = car.drives[0]
    cut_ns = drive.start_ns + 60 * NANOSECONDS
    method, rows = OnlineChain(vehicle), []
    other = UnseenDrive(
        "tripled",
        tuple(
            BatteryReading(reading.stamp_ns, reading.voltage, 3 * reading.current)
            if isinstance(reading, BatteryReading) and reading.stamp_ns > cut_ns
            else reading
            for reading in drive.readings
        ),
    )
    index = next(i for i, reading in enumerate(drive.readings) if reading.stamp_ns > cut_ns)
    for reading in drive.readings[:index]:
        rows.extend(method.add_reading(reading))
    span = DrivePart(60.0, 130.0)
    true, tripled = (
        predicted(copy.deepcopy(method), told, index, span, rows[-1:]) for told in (drive, other)
    )
    assert np.array_equal(true.power.value, tripled.power.value)
    assert len(true.power.value) > 325


def test_an_error_of_power_is_found_in_every_score(car, true_power):
    bias = 100.0
    scores = summary(run_car(car, lambda vehicle: Oracle(true_power, bias)))
    assert scores["withheld"]["rmse_w"] == pytest.approx(bias)
    assert scores["carried"]["means_w"]["60"] == pytest.approx(bias)
    drive = car.drives[1]
    gross = drive.power.gross(DrivePart(0.0, drive.duration))
    expected = 100 * bias * drive.duration / gross
    assert scores["carried"]["gross_mean_percent"] == pytest.approx(expected, rel=1e-5)
    assert scores["by_battery_age"]["60"]["rmse_w"] == pytest.approx(bias)


def test_gaps_of_the_battery_are_not_scored(make_drive, true_power):
    whole = make_drive(300.0)
    lost = tuple(
        reading
        for reading in whole.readings
        if not (
            isinstance(reading, BatteryReading) and 100 < whole.seconds(reading.stamp_ns) < 200
        )
    )
    drive = UnseenDrive("lost", lost)
    track = predicted(Oracle(true_power, 50.0), drive, 0, DrivePart(0.0, 300.0), [])
    score = score_part(drive, track, DrivePart(0.0, drive.duration))
    assert score.error == pytest.approx(50.0 * (drive.duration - 100.0), rel=1e-3)
    assert math.isclose(score.covered, 1.0)
