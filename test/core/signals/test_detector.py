"""One hysteresis for all detectors."""

import math

import pytest

from evpinn_ros.core.signals.detector import AGAINST_INERTIA, TABLE
from evpinn_ros.core.signals.height import AltitudeDetector
from evpinn_ros.core.signals.sign_detectors import ChargeDetector, GradeDetector, SignDetector
from evpinn_ros.core.signals.stuck import StuckDetector


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.fault}_{row.on:g}")
def test_between_its_limits_a_verdict_stays(row):
    enough, beyond = row.least, math.nextafter(row.on, math.inf)
    for before in (None, False, True):
        assert row.judge(before, beyond, enough) is True
        assert row.judge(before, row.off, enough) is False
        assert row.judge(before, math.nan, enough) is before
        if row.least:
            assert row.judge(before, beyond, 0.99 * row.least) is before
        if row.off < row.on:
            assert row.judge(before, row.on, enough) is before


def test_a_limit_is_none_of_its_own():
    assert AGAINST_INERTIA.judge(None, 0.5, 10.0) is None


@pytest.mark.parametrize(
    "detector",
    [
        *(AltitudeDetector(), ChargeDetector(), GradeDetector()),
        *(SignDetector(), StuckDetector().verdict),
    ],
)
def test_of_nothing_nothing_is_learned(detector):
    """An altitude alone counts as stuck until it moves."""
    assert detector.detected == ("altitude_stuck" if detector == AltitudeDetector() else None)
