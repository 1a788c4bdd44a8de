"""Simulated cars against their truth: the sums and the intervals."""

import numpy as np
import pytest

from benchmarks.truth import compare
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.replays.simulation.drive import DriveKind

pytestmark = pytest.mark.nightly


def test_intervals_of_cars_drawn_from_the_priors_are_true():
    """Twenty cars for two minutes; `evpinn bench truth --from-priors` has the figures."""
    checks = list(
        compare(DriveKind.URBAN, ["tesla_model_3_lr"], range(20), marks=(120,), from_priors=True)
    )
    assert {check.name for check in checks} == {*PARAMETER_NAMES, *IDENTIFIABLE_NAMES}
    covered = np.mean([check.covered for check in checks])
    # 180 intervals, at least 20 of them independent: 1-sigma of the share is at most 5 %.
    assert covered >= 0.95 - 3 * 0.05
