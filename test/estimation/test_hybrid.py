from dataclasses import replace
from itertools import pairwise
import math

import numpy as np
import pytest

from evpinn_ros.estimation.estimate import State
from evpinn_ros.estimation.hybrid import MIN_SAMPLES, TRUST_PRIOR, WIDTHS, HybridLearner
from evpinn_ros.estimation.power_filter import DRIFT
from evpinn_ros.estimation.window_network import WindowNetwork
from evpinn_ros.signals.kinematics import COURSE
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.identifiable import combined_power, identifiable
from evpinn_ros.vehicle.parameters import LIMITS, Parameters

TRUTH = Parameters(eta=0.85, mu=0.78, mass=1960.0, c_rr=0.0105, c_d=0.235, p_aux=1250.0)


def teach(learner: HybridLearner, drive) -> HybridLearner:
    for sample, power in zip(drive.samples, drive.powers, strict=True):
        learner.advance(sample)
        learner.observe(sample, power)
    return learner


def second(learner: HybridLearner, drive, k: int) -> None:
    """The samples of one second."""
    for sample, power in list(zip(drive.samples, drive.powers, strict=True))[5 * k : 5 * k + 5]:
        learner.advance(sample)
        learner.observe(sample, power)


def said(output: float) -> WindowNetwork:
    """A network that says the same everywhere."""
    weights = np.zeros(sum(a * b + b for a, b in pairwise(WIDTHS)))
    weights[-1] = output
    return WindowNetwork(WIDTHS, weights)


def test_before_anything_it_says_what_the_prior_says(vehicle):
    learner = HybridLearner(vehicle)
    sample = Sample(0, 15.0, 0.3, 0.0, 1.17, 200.0)
    expected = combined_power(
        15.0,
        0.3,
        identifiable(vehicle.initial, vehicle.frontal_area),
        air_density=1.17,
        rotating_mass_factor=vehicle.rotating_mass_factor,
    )
    prediction = learner.predict(sample)
    assert prediction.power == pytest.approx(expected + 200.0)
    assert prediction.sigma > 0 and learner.trust == 0.0
    assert learner.prepare_update() is None
    states = {found.state for found in learner.parameters().parameters.values()}
    assert states == {State.UNESTIMATED} and not learner.parameters().reliable


def test_after_two_minutes_of_town_it_is_reliable(vehicle, synthetic):
    found = teach(HybridLearner(vehicle), synthetic(TRUTH, noise=0.5)).parameters()
    assert found.reliable
    assert found.parameters["mass"].state is State.VALID
    # Nothing tells C_d in town: its own prior is all there is.
    assert found.parameters["c_d"].state is State.UNESTIMATED
    for name, estimate in found.parameters.items():
        assert estimate.lower <= estimate.value <= estimate.upper, name
        assert 0.0 <= estimate.prior_share <= 1.0 and estimate.std > 0


def test_bounds_by_hand(vehicle, synthetic):
    """eta and mu in [q, 1]; mass in [q, 1] m/eta; C_d likewise, with the drag area over A.

    Each combination is taken two sigmas to the safe side.
    """
    found = teach(HybridLearner(vehicle), synthetic(TRUTH, noise=0.5)).parameters()
    combined, std, bounds = found.identifiable, found.identifiable_std, found.parameters
    q = combined.regeneration - 2 * std.regeneration
    assert (bounds["eta"].lower, bounds["eta"].upper) == (pytest.approx(q), 1.0)
    assert (bounds["mu"].lower, bounds["mu"].upper) == (pytest.approx(q), 1.0)
    low, high = (combined.mass_over_eta + sign * 2 * std.mass_over_eta for sign in (-1, 1))
    assert bounds["mass"].lower == pytest.approx(q * low)
    assert bounds["mass"].upper == pytest.approx(high)
    assert bounds["mass"].lower < TRUTH.mass < bounds["mass"].upper


def test_before_the_data_tell_anything_bounds_are_the_limits(vehicle):
    for name, estimate in HybridLearner(vehicle).parameters().parameters.items():
        assert (estimate.lower, estimate.upper) == LIMITS[name]


def test_reverse_and_charging_teach_nothing(vehicle):
    learner = HybridLearner(vehicle)
    before = learner.export()
    learner.observe(Sample(0, -0.11, 0.0, 0.0, 1.17, 0.0), 5000.0)
    learner.observe(Sample(NANOSECONDS, 0.05, 0.0, 0.0, 1.17, 0.0), -501.0)
    assert learner.gated == {"reverse": 1, "charging": 1}
    assert learner.export() == before
    learner.observe(Sample(2 * NANOSECONDS, 0.05, 0.0, 0.0, 1.17, 0.0), -499.0)
    learner.observe(Sample(3 * NANOSECONDS, 5.0, -1.0, 0.0, 1.17, 0.0), -9000.0)
    assert learner.gated.total() == 2 and learner.export() != before


def test_an_update_waits_for_samples_and_trains_a_copy(vehicle, synthetic):
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH)
    for k in range(MIN_SAMPLES // 5):
        assert learner.prepare_update() is None
        second(learner, drive, k)
    before = learner.export()
    work = learner.prepare_update()
    first, again = work(), learner.prepare_update()()
    assert learner.export() == before
    assert np.array_equal(first.weights, again.weights)
    assert not np.array_equal(first.weights, before["network"])


def test_work_is_a_snapshot(vehicle, synthetic):
    """What is observed after `prepare_update` does not reach the work, whenever it runs."""
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH)
    for k in range(40):
        second(learner, drive, k)
    at_once, later = learner.prepare_update()(), learner.prepare_update()
    for k in range(40, 60):
        second(learner, drive, k)
    assert np.array_equal(at_once.weights, later().weights)


@pytest.mark.parametrize(("offset", "adopted"), [(1.0, True), (-1.0, False)])
def test_a_candidate_must_foretell_the_next_second_better(vehicle, synthetic, offset, adopted):
    """The next second reads more than physics says: a network that says more is adopted."""
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH, noise=0.0, hills=0.0)
    for k in range(40):
        second(learner, drive, k)
    assert learner.consider(said(offset)) == "not_judged_yet"
    for sample, _ in zip(drive.samples[200:205], range(5), strict=True):
        learner.advance(sample)
        physics = learner.power_filter.predict(sample).power
        learner.observe(sample, physics + learner.power_filter.residual_std(sample))
    reason = learner.consider(said(0.0))
    assert reason == (None if adopted else "not_better")
    expected = said(offset) if adopted else learner._start
    assert learner.export()["network"] == expected.weights.tolist()


def test_a_candidate_that_is_not_finite_is_never_adopted(vehicle, synthetic):
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH)
    for k in range(40):
        second(learner, drive, k)
    start = learner.export()["network"]
    assert learner.consider(said(math.nan)) == "not_finite"
    for k in range(40, 45):
        second(learner, drive, k)
    learner.consider(said(0.5))
    assert learner.export()["network"] == start


def test_forgetting_the_window_forgets_the_candidate_and_nothing_learned(vehicle, synthetic):
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH)
    for k in range(40):
        second(learner, drive, k)
    candidate = said(1.0)
    learner.consider(candidate)
    before = learner.export()
    learner.forget_window()
    after = learner.export()
    assert after["network"] == before["network"]
    for kept in ("parameter_filter", "power_filter"):
        assert after[kept]["mean"][:5] == before[kept]["mean"][:5]
    assert learner.prepare_update() is None
    assert learner.consider(candidate) == "not_judged_yet"


def test_trust_is_the_regression_on_what_the_network_says(vehicle, synthetic):
    """Physics is off by half of what the network says: trust goes to 0.5, less its prior.

    n samples, each with said = 1 and left = 0.5: merit (0.5 n, n + 200) while nothing is
    forgotten, and 200 is kept up when something is.
    """
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH, seconds=600.0)
    learner._network = said(1.0)
    for sample in drive.samples[:2000]:
        learner.advance(sample)
        scale = learner.power_filter.residual_std(sample)
        learner._judge(sample, 0.5 * scale, 0.2)
    keep = 1 - 0.2 / 300.0
    seen = (1 - keep**2000) / (1 - keep)
    assert learner.trust == pytest.approx(0.5 * seen / (seen + TRUST_PRIOR), rel=1e-6)


def test_the_network_does_no_harm(vehicle, synthetic):
    """A drivetrain that wastes 4 kW at about 8 m/s alone: no state of the filter knows it."""
    drive = synthetic(TRUTH, seconds=200.0, noise=0.2, hills=0.0)
    learner = HybridLearner(vehicle)
    physics, both = [], []
    for k, (sample, power) in enumerate(zip(drive.samples, drive.powers, strict=True)):
        measured = power + 4000.0 * math.exp(-(((sample.speed - 8.0) / 1.5) ** 2))
        learner.advance(sample)
        if k > 500:
            physics.append(learner.power_filter.predict(sample).power - measured)
            both.append(learner.predict(sample).power - measured)
        learner.observe(sample, measured)
        if k % 15 == 14:  # every third second saves time
            work = learner.prepare_update()
            if work is not None:
                learner.consider(work())
    assert learner._candidate is not None
    assert np.linalg.norm(both) < 1.005 * np.linalg.norm(physics)


def test_the_load_is_met_where_the_car_is_and_not_foretold(vehicle):
    """A head wind of 300 N that nothing reports: `smoothed` samples know it in some seconds.

    The newest sample, which has no course, is predicted without it; a standing car meets none.
    """
    learner = HybridLearner(vehicle)
    smoothed = [
        Sample(k * NANOSECONDS // 10, 15.0, 0.0, 0.0, 1.17, 0.0, (0.0,) * COURSE)
        for k in range(100)
    ]
    for sample in smoothed:
        learner.advance(sample)
        learner.observe(sample, learner.power_filter.predict(sample).power + 300.0 * 15.0)
    last = smoothed[-1]
    physics = learner.power_filter.predict(last)
    met = learner.predict(last).power - physics.power
    assert 0.5 * 4500.0 < met < 4500.0
    newest = replace(last, course=())
    assert learner.predict(newest).power == learner.power_filter.predict(newest).power
    assert learner.predict(replace(last, speed=0.0)).power == pytest.approx(
        learner.power_filter.predict(replace(last, speed=0.0)).power
    )
    assert learner.predict(last).sigma > physics.sigma
    learner.forget_window()
    assert learner.predict(last).power == learner.power_filter.predict(last).power


def test_samples_from_before_time_went_back_count_as_old(vehicle, synthetic):
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH)
    teach(learner, drive)
    for observation in list(learner._window):
        learner._store.add(observation)
    learner.forget_window()
    learner.observe(Sample(0, 10.0, 0.0, 0.0, 1.17, 0.0), 5000.0)
    observations = [*learner._window, *learner._store]
    inputs = learner._problem(observations, 0).inputs
    assert np.array_equal(np.unique(inputs[:, 2]), [0.0, 1.0])


def test_what_the_window_showed_fades_in_silence_and_is_unproven_after_a_jump(vehicle, synthetic):
    """A drivetrain that wastes 3 kW: physics and network share it, and only the window's fades."""
    learner, drive = HybridLearner(vehicle), synthetic(TRUTH, seconds=60.0)
    teach(learner, drive)
    learner._network = said(2.0)
    learner._merit[:] = 500.0, 1000.0
    last = drive.samples[-1]
    told = []
    for silence in (0, 60, 600):
        sample = replace(last, stamp_ns=last.stamp_ns + silence * NANOSECONDS)
        told.append(learner.predict(sample).power - learner.power_filter.predict(sample).power)
    network = 0.5 * 2.0 * learner.power_filter.residual_std(last)
    load = told[0] - network
    assert told[1] - load == pytest.approx(network / math.e)
    assert told[2] - load == pytest.approx(0.0, abs=0.01 * network)
    learner.forget_window()
    assert learner.trust == 0.0


@pytest.mark.parametrize(
    ("seconds", "same"),
    [(3.0, True), (-3.0, True), (-300.0, True), (900.0, False), (-900.0, False)],
)
@pytest.mark.parametrize("told", [True, False])
def test_a_clock_that_is_set_right_ends_no_drive(vehicle, seconds, same, told):
    """`told`: the stream saw the jump and had the window forgotten."""
    learner = HybridLearner(vehicle)
    drive = [Sample(k * NANOSECONDS, 10.0, 0.0, 0.0, 1.17, 1500.0) for k in range(1200)]
    for sample in drive:
        learner.advance(sample)
        learner.observe(sample, 9000.0)
    before = learner.export()["power_filter"]["loads"]
    if told:
        learner.forget_window()
    last = drive[-1]
    learner.advance(replace(last, stamp_ns=last.stamp_ns + round(seconds * NANOSECONDS)))
    after = learner.export()["power_filter"]["loads"]
    assert (after == before) == same
    assert (after["drive"][0] == 0.0) != same


@pytest.mark.parametrize(("pause", "kept"), [(1.0, True), (8 * 3600.0, False), (-3600.0, False)])
def test_the_next_drive_has_loads_and_slopes_of_its_own(vehicle, synthetic, pause, kept):
    """A restart goes on where it was; a night later, or on a clock set back, it does not."""
    drive = synthetic(TRUTH, seconds=60.0)
    learner = teach(HybridLearner(vehicle), drive)
    learner.power_filter.mean[DRIFT] = 900.0
    again = HybridLearner(vehicle)
    again.restore(learner.export())
    last = drive.samples[-1]
    again.advance(replace(last, stamp_ns=last.stamp_ns + round(pause * NANOSECONDS)))
    assert again.power_filter.mean[DRIFT] == pytest.approx(900.0 if kept else 0.0, rel=0.01)
    assert again.power_filter.mean[0] == pytest.approx(learner.power_filter.mean[0], rel=0.01)
