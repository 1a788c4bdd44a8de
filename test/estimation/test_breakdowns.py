"""Breakdowns of drives of one car: kept beside each other, and compared."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from evpinn_ros.estimation.breakdown import DISTANCE, Breakdowns
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.terms import COUNT, WHOLE, Part
from evpinn_ros.vehicle.files import load_vehicle
from test.estimation.test_breakdown import driven

MODEL_3 = load_vehicle("tesla_model_3_lr")


def breakdowns(seeds: tuple[int, ...], keep: bool = True) -> Breakdowns:
    filter_ = CarFilter(MODEL_3)
    for seed, following in pairwise((*seeds, None)):
        driven(filter_, seed, 60, share=1.05)
        if following is not None:
            filter_.begin_drive(keep)
    assert filter_.parts is not None
    return filter_.parts.breakdowns(filter_.weights, 2e4, filter_.hilliness)


@pytest.mark.slow
def test_kept_drives_may_have_other_tyres_and_change_nothing_else():
    kept, alone = breakdowns((1, 2)), breakdowns((1, 2), keep=False)
    assert len(kept.drives) == 2 and len(alone.drives) == 1
    assert kept.drives[-1].distance == alone.drives[-1].distance
    tyres = [found.of(-1).of(Part.TYRES).sigma_kwh for found in (kept, alone)]
    assert tyres[0] > tyres[1]
    assert breakdowns((1,)).energy == pytest.approx(breakdowns((1,), keep=False).energy)


def test_the_joint_covariance_is_one():
    """Possible, and of each drive what its own block is."""
    found = breakdowns((1, 2, 3))
    whole = found.covariance.reshape(3 * COUNT, 3 * COUNT)
    assert np.abs(whole - whole.T).max() <= 1e-6 * np.abs(whole).max()
    assert np.linalg.eigvalsh(whole).min() >= -1e-6 * np.abs(whole).max()


def test_a_later_drive_sharpens_what_is_known_of_an_earlier_one():
    one, both = breakdowns((1,)).of(0), breakdowns((1, 2)).of(0)
    assert both.measured == one.measured and both.seconds == one.seconds
    assert both.of(Part.TYRES).sigma_kwh < one.of(Part.TYRES).sigma_kwh


def test_what_is_not_known_of_the_car_leaves_the_difference():
    """The same drive twice: what the drivetrain of each lost is unsure, the difference is not."""
    found = breakdowns((1, 1))
    parts = [found.of(drive).of(Part.DRIVETRAIN) for drive in (0, 1)]
    apart = np.hypot(*(part.sigma_kwh / found.of(0).distance * DISTANCE for part in parts))
    difference = found.difference(1, 0).of(Part.DRIVETRAIN)
    assert difference.sigma_kwh < 0.3 * apart
    assert difference.kwh_per_100km == pytest.approx(difference.kwh)


def test_drives_of_other_power_leave_an_error_of_the_efficiency_map():
    """Twice the energy in the same time: air and drivetrain are the less sure, together not."""
    found = breakdowns((1, 1))
    totals = [replace(found.drives[0], seconds=found.drives[0].seconds / 2), found.drives[1]]
    unlike = replace(found, drives=tuple(totals))
    for parts, more in (((Part.AIR,), 1.05), ((Part.DRIVETRAIN,), 1.2)):
        sigmas = [each.difference(1, 0).of(*parts).sigma_kwh for each in (unlike, found)]
        assert sigmas[0] > more * sigmas[1]
    pair = Part.AIR, Part.DRIVETRAIN
    sigmas = [each.difference(1, 0).of(*pair).sigma_kwh for each in (unlike, found)]
    assert sigmas[0] == pytest.approx(sigmas[1])


def test_a_difference_is_the_one_less_the_other_per_100_km_and_adds_up():
    found = breakdowns((1, 2))
    one, other = found.of(0).amounts(), found.of(1).amounts()
    difference = found.difference(1, 0)
    for name, part in difference.amounts().items():
        less = other[name].kwh_per_100km - one[name].kwh_per_100km
        assert part.kwh_per_100km == pytest.approx(less, abs=1e-9)
    whole = sum(part.kwh for name, part in difference.amounts().items() if name != "regained")
    assert whole == pytest.approx(difference.total().kwh)


def test_pieces_of_one_drive_are_joined():
    found = breakdowns((1, 2, 3))
    joined = found.joined([0, 0, 1])
    assert joined.drives[0].seconds == sum(each.seconds for each in found.drives[:2])
    assert joined.energy[0] == pytest.approx(found.energy[:2].sum(0))
    every = found.covariance.reshape(3 * COUNT, 3 * COUNT)
    weights = np.zeros((3, COUNT))
    weights[:2, WHOLE] = 1.0
    sigma = np.sqrt(weights.ravel() @ every @ weights.ravel())
    own = joined.covariance[0][WHOLE][:, 0, WHOLE].sum()
    assert np.sqrt(own) == pytest.approx(sigma)
    assert joined.of(1).measured == found.of(2).measured


def test_a_drive_of_no_interval_takes_no_place():
    filter_ = driven(CarFilter(MODEL_3), 1, 10)
    for _ in range(3):
        filter_.begin_drive(keep=True)
    found = filter_.parts.breakdowns(filter_.weights, 2e4, 0.0)
    assert len(found.drives) == 2 and found.of(1) is None
