"""Scores of the distance to empty, on a road of even cost."""

import math

import pytest

from benchmarks.empty import Kilometre, _errors
from evpinn_ros.core.energy.remaining import Cost
from evpinn_ros.core.energy.trip import Stretch

EVEN, TWICE = Cost(500.0, 500.0, 0.2), Cost(1000.0, 1000.0, 0.1)


def test_a_road_is_judged_along_its_route_where_it_ends_in_the_same_drive():
    road = [
        Kilometre(index // 15, Stretch(1e3, 500e3), (), None, EVEN, 250.0, 500.0)
        for index in range(30)
    ]
    errors = list(_errors(road, [TWICE] * 30, 10e3))
    assert len(errors) == 20
    for index, (ours, last_10, last_100, inside, along, on_it) in enumerate(errors):
        assert (ours, last_10, last_100) == pytest.approx((0.0, 1.0, 0.0), abs=1e-3) and inside
        one_drive = index // 15 == (index + 10) // 15
        assert math.isnan(along) != one_drive and not on_it
        assert not one_drive or along == pytest.approx(-0.5, abs=1e-3)
