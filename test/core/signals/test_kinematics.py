import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.signals.kinematics import (
    INITIAL_TAPS,
    PROFILE,
    PROFILE_EDGES,
    TAP_STD,
    TAPS,
    TARGET_STD,
    CausalDifferentiator,
    SpeedTrack,
    profile,
)
from evpinn_ros.core.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from test.core.signals.conftest import Stream
from test.core.signals.conftest import stamp_at as at


def track(times, speeds) -> SpeedTrack:
    speed_track = SpeedTrack(2.5)
    stamps = np.array([at(time) for time in times], np.int64)
    speed_track.extend(stamps, np.array(speeds, dtype=float))
    return speed_track


def smoothed(speed_track: SpeedTrack, moment: float, until: float) -> tuple[float, float]:
    """Speed and acceleration at a moment from speeds up to another, s."""
    speeds = speed_track.since(at(0.0), at(0.0))
    last = np.searchsorted(speeds.stamps, at(until) - at(0.0), side="right")
    speed, acceleration = speeds.smoothed(np.array([at(moment) - at(0.0)]), np.array([last]))
    return float(speed[0]), float(acceleration[0])


def profile_of(speed_track: SpeedTrack, moment: float, until: float, acceleration: float):
    """Acceleration profile at a moment from speeds up to another, s."""
    speeds = speed_track.since(at(0.0), at(0.0))
    last = np.searchsorted(speeds.stamps, at(until) - at(0.0), side="right")
    slopes = speeds.slopes(np.array([at(moment) - at(0.0)]), np.array([last]))
    return profile(slopes, np.array([acceleration]))[0].tolist()


def differences(speed_track: SpeedTrack) -> np.ndarray:
    """Mean slopes of speed before the newest one."""
    return speed_track.since(speed_track.stamps[0], speed_track.newest_ns).differences(
        np.zeros(1, int)
    )[0]


steps = st.lists(st.floats(0.01, 0.5), min_size=8, max_size=40)
coefficients = st.tuples(st.floats(-30, 30), st.floats(-4, 4), st.floats(-2, 2))


@given(steps, coefficients, st.integers(4, 40))
def test_the_local_quadratic_is_exact_on_quadratics_at_uneven_steps(gaps, shape, pick):
    times = np.cumsum(gaps)
    level, slope, bend = shape
    speeds = level + slope * times + bend * times**2
    moment = times[min(pick, len(times) - 3)]
    fitted = smoothed(track(times, speeds), moment, times[-1])
    expected = (level + slope * moment + bend * moment**2, slope + 2 * bend * moment)
    assert fitted == pytest.approx(expected, rel=1e-6, abs=1e-5)


@pytest.mark.parametrize("rate", [2.0, 10.0, 33.0, 100.0])
def test_a_constant_acceleration_has_no_profile(rate):
    times = np.arange(0, 4, 1 / rate)
    excess = profile_of(track(times, 3.0 + 1.5 * times), 2.0, times[-1], 1.5)
    assert excess == pytest.approx([0.0] * PROFILE, abs=1e-6)


def test_the_profile_of_a_jerk_by_hand():
    """v = t^3 / 6 m/s: mean slopes over the spans, less a = t^2 / 2 at 2 s."""
    times = np.arange(0, 40) / 10
    excess = profile_of(track(times, times**3 / 6), 2.0, 2.3, 2.0)
    begin, end = 2.0 + PROFILE_EDGES.T
    expected = (end**3 - begin**3) / 6 / (end - begin) - 2.0
    assert excess == pytest.approx(expected, abs=1e-6)
    assert excess[0] > 0.3 and excess[-1] < -0.8


def test_what_is_not_known_has_no_profile():
    """Neither before the first speed nor after the last that may be used."""
    times = 1.6 + np.arange(0, 10) / 10
    speeds = np.random.default_rng(0).standard_normal(10)
    excess = profile_of(track(times, speeds), 2.0, 2.1, 0.5)
    assert excess[0] == excess[2] == 0.0 != excess[1]
    speeds[6:] += 5.0  # of 2.2 s on
    assert profile_of(track(times, speeds), 2.0, 2.1, 0.5) == excess


@given(steps, st.floats(-5, 20))
@settings(max_examples=25)
def test_distance_and_flow_are_exact_where_speed_is_linear(gaps, head_wind):
    """In pieces as in one, and as the integrals of v and w |w| v by hand."""
    times = np.cumsum(gaps)
    linear = track(times, 5.0 + 2.0 * times)
    stamps = [at(time) for time in times]
    ends = np.array([stamps[0], stamps[-1]])
    whole = [column[0] for column in linear.driven(ends, np.array([head_wind]))[:2]]
    pieces = linear.driven(np.array(stamps), np.full(len(stamps) - 1, head_wind))[:2]
    assert np.sum(pieces, axis=1) == pytest.approx(whole, rel=1e-9)
    fine = np.linspace(times[0], times[-1], 20_001)
    speed = 5.0 + 2.0 * fine
    flow = speed + head_wind
    expected = (np.trapezoid(speed, fine), np.trapezoid(flow * np.abs(flow) * speed, fine))
    assert whole == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_smoothing_averages_noise():
    """A quadratic through 9 points at 10 Hz: the variance of its slope by ordinary algebra."""
    times = np.arange(9) * 0.1
    moment = 0.5
    basis = np.stack((np.ones(9), times - moment, (times - moment) ** 2), axis=1)
    expected = math.sqrt(np.linalg.inv(basis.T @ basis)[1, 1])
    rng = np.random.default_rng(0)
    slopes = [smoothed(track(times, rng.standard_normal(9)), moment, 0.8)[1] for _ in range(2000)]
    assert np.std(slopes) == pytest.approx(expected, rel=0.06)  # 4 sigma of 2000 draws


def test_differences_by_hand():
    # 0 at 0 s, 1 at 0.1 s, 3 at 0.2 s: slopes 20 and 10 m/s^2, and nothing before.
    fast = differences(track([0.0, 0.1, 0.2], [0.0, 1.0, 3.0]))
    assert fast == pytest.approx([20.0, 10.0] + [0.0] * (TAPS - 2))
    # Between readings, linear: 1 Hz readings 2 m/s apart give 2 m/s^2 throughout.
    slow = differences(track([0.0, 1.0, 2.0], [0.0, 2.0, 4.0]))
    assert slow == pytest.approx([2.0] * TAPS)


def test_the_differentiator_learns_a_rule_that_is_linear():
    rng = np.random.default_rng(0)
    rule = rng.standard_normal(TAPS) / TAPS
    slopes = rng.standard_normal((3001, TAPS))
    learned = CausalDifferentiator().learn(slopes[:3000], slopes[:3000] @ rule)
    accelerations = (slopes * learned.weights(np.arange(3001))).sum(axis=1)
    # Ridge regression with penalty (0.2 / 0.2)^2 = 1 on about 3000 unit rows: 1/3000 is left.
    assert accelerations[-1] == pytest.approx(float(slopes[-1] @ rule), abs=TAPS * 1e-3)
    # By hand: all sums up to each.
    for k in (0, 1, 7, 200):
        weights = np.zeros(TAPS)
        weights[:INITIAL_TAPS] = 1.0 / INITIAL_TAPS
        information = np.eye(TAPS) / TAP_STD**2
        products = information @ weights
        information = information + slopes[:k].T @ slopes[:k] / TARGET_STD**2
        products = products + slopes[:k].T @ (slopes[:k] @ rule) / TARGET_STD**2
        expected = slopes[k] @ np.linalg.solve(information, products)
        assert accelerations[k] == pytest.approx(float(expected), rel=1e-9)


def test_the_learned_differentiator_beats_a_plain_difference():
    """Noisy simulated speed against the true acceleration, the second half of two minutes."""
    drive = simulate(DriveKind.URBAN, load_vehicle("tesla_model_3_lr"), 120.0, 1)
    readings = [r for r in drive.readings if isinstance(r, SpeedReading)]
    times = (np.array([r.stamp_ns for r in readings]) - readings[0].stamp_ns) / NANOSECONDS
    times += (readings[0].stamp_ns - 1_735_689_600 * NANOSECONDS) / NANOSECONDS
    truth = np.interp(times, drive.trace.motion.time, drive.trace.motion.acceleration)
    learned = Stream().add(readings).newest.samples.acceleration
    speeds = track([], [])
    first_guess = []
    for reading in readings:
        speeds.extend(np.array([reading.stamp_ns]), np.array([reading.speed]))
        first_guess.append(differences(speeds)[:INITIAL_TAPS].mean())
    raw = np.diff([r.speed for r in readings], prepend=0.0) / np.diff(times, prepend=-1.0)

    def error(estimate) -> float:
        late = slice(len(times) // 2, None)
        return float(np.sqrt(np.mean((np.asarray(estimate)[late] - truth[late]) ** 2)))

    assert error(learned) < error(first_guess)
    assert error(learned) < 0.9 * error(raw)
