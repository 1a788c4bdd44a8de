"""The map of speed and acceleration that was learned from."""

import math

import pytest

from evpinn_ros.core.estimation.operating_range import OperatingRange
from evpinn_ros.core.signals.sample import Sample, Samples


@pytest.mark.parametrize(
    "kmh, acceleration, place",
    [
        (0.0, 0.0, "0_30_kmh_steady"),
        (29.9, 1.0, "0_30_kmh_accelerating"),
        (-20.0, -1.0, "0_30_kmh_braking"),
        (30.1, 0.1, "30_60_kmh_steady"),
        (119.0, -2.0, "90_120_kmh_braking"),
        (200.0, 0.5, "over_120_kmh_accelerating"),
    ],
)
def test_a_sample_has_its_place(kmh, acceleration, place):
    seen = OperatingRange()
    seen.add(Samples.of([Sample(0, kmh / 3.6, acceleration, 0.0, 1.2, math.nan)]))
    counts = seen.counts()
    assert counts[place] == 1 and sum(counts.values()) == 1 and len(counts) == 15
