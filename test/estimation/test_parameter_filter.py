from dataclasses import replace
import math

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.estimation.parameter_filter import (
    COPPER,
    ETA,
    FORCE_NOISE,
    MASS,
    MU,
    NOISE_RANGE,
    P_AUX,
    POWER_NOISE,
    SLOPE,
    STATES,
    TIME_CONSTANTS,
    ParameterFilter,
)
from evpinn_ros.estimation.window import Observation, batch
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import load_vehicle
from evpinn_ros.vehicle.identifiable import combined_power, identifiable
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES, Parameters, Prior
from evpinn_ros.vehicle.physics import RegenForm, battery_power

MODEL_3 = load_vehicle("tesla_model_3_lr")
CAR = replace(MODEL_3, priors={**MODEL_3.priors, "p_aux": Prior(1100.0, 400.0, "this test")})
NULL = np.zeros(len(STATES))  # eta, mass and C_d up, mu down: nothing measurable changes
NULL[[ETA, MU, MASS, 4]] = 0.5, -0.5, 0.5, 0.5
TRUTH = Parameters(eta=0.85, mu=0.78, mass=1960.0, c_rr=0.0105, c_d=0.235, p_aux=1250.0)

samples = st.builds(
    Sample,
    stamp_ns=st.just(0),
    speed=st.floats(-5.0, 45.0),
    acceleration=st.floats(-5.0, 4.0),
    grade=st.floats(-0.1, 0.1),
    air_density=st.floats(1.0, 1.4),
    known_auxiliary=st.floats(0.0, 3000.0),
    head_wind=st.floats(-15.0, 15.0),
)
states = st.lists(st.floats(-2.0, 2.0), min_size=len(STATES), max_size=len(STATES))


def new(*, copper_loss=False) -> ParameterFilter:
    return ParameterFilter(CAR, copper_loss=copper_loss)


def sample(second, speed=0.0, acceleration=0.0, **others) -> Sample:
    values = {"grade": 0.0, "air_density": 1.17, "known_auxiliary": 0.0, **others}
    return Sample(round(second * NANOSECONDS), speed, acceleration, **values)


def moved(by) -> ParameterFilter:
    """A filter some prior sigmas away from its prior."""
    found = new(copper_loss=True)
    found.mean = found.mean + np.array(by) * np.sqrt(np.diag(found.covariance))
    return found


def learn(to: ParameterFilter, drive, step: float) -> ParameterFilter:
    for moment, power in zip(drive.samples, drive.powers, strict=True):
        to.advance(moment)
        to.update(moment, power, step)
    return to


def test_it_starts_at_the_priors():
    found = new()
    assert found.parameters() == pytest.approx(CAR.initial)
    std = [CAR.priors[name].std for name in PARAMETER_NAMES]
    assert found.parameter_std() == pytest.approx(std)
    assert found.prior_share() == (1.0,) * 6
    value, std, share = found.identifiable()
    assert value == pytest.approx(identifiable(CAR.initial, CAR.frontal_area))
    # m/eta: relative 1-sigma of 110/1823 and 0.1/0.7 together, of 2604.29 kg
    assert std.mass_over_eta == pytest.approx(2604.2857 * math.hypot(110 / 1823, 1 / 7))
    assert share == (1.0,) * 5


@given(samples, states)
@settings(deadline=None)
def test_power_is_that_of_the_physics(moment, by):
    """Without copper loss, slope and wind, eq. 19 in the wheel-power form plus the known load."""
    found = moved(by)
    moment = replace(moment, head_wind=0.0)
    found.mean[[COPPER, SLOPE]] = 0.0
    power = battery_power(
        moment.speed,
        moment.acceleration * CAR.rotating_mass_factor,  # in the inertia alone
        found.parameters(),
        area=CAR.frontal_area,
        air_density=moment.air_density,
        form=RegenForm.WHEEL_POWER,
        beta=CAR.beta,
        grade=moment.grade,
    )
    expected = power + moment.known_auxiliary
    assert found.predict(moment).power == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_drag_is_that_of_the_airspeed():
    """At 20 m/s against 5 m/s of wind the drag of 25 m/s, moved at 20 m/s."""
    found = new()
    still, windy = (found.predict(sample(0, 20.0, head_wind=wind)).power for wind in (0.0, 5.0))
    drag_area = CAR.frontal_area * CAR.initial.c_d
    expected = 0.5 * 1.17 * drag_area * (25.0**2 - 20.0**2) * 20.0 / CAR.initial.eta
    assert windy - still == pytest.approx(expected)


@given(samples, states, st.floats(-0.02, 0.02))
@settings(max_examples=25, deadline=None)
def test_the_gradient_is_that_of_finite_differences(moment, by, slope):
    """At no slope all of it; on a slope nobody reported, but for mass, eta and mu.

    Those are not to be learned by a force that is itself a guess.
    """
    found = moved(by)
    for believed, indices in ((0.0, range(len(STATES))), (slope, (3, 4, P_AUX, COPPER, SLOPE))):
        found.mean[SLOPE] = believed
        prediction, start = found.predict(moment), found.mean.copy()
        # At the bend of wheel power, W = 0, there is no gradient.
        wheel = prediction.power - start[P_AUX] - moment.known_auxiliary
        assume(abs(wheel - start[COPPER] * moment.acceleration**2) > 50.0)
        for index in indices:
            step = 1e-2 if index in (P_AUX, COPPER) else 1e-6
            power = {}
            for sign in (-1, 1):
                found.mean = start.copy()
                found.mean[index] += sign * step
                power[sign] = found.predict(moment).power
            found.mean = start
            difference = (power[1] - power[-1]) / (2 * step)
            gradient = prediction.gradient[index]
            # That rolling resistance falls with cos(th) is left out: C_rr tan(th) < 1 %.
            tolerance = 0.01 * abs(gradient) if index == SLOPE else 0.0
            tolerance += 1e-5 * (abs(gradient) + abs(prediction.power) + 1.0)
            assert difference == pytest.approx(gradient, abs=tolerance)


@given(samples, states)
@settings(deadline=None)
def test_columns_agree_with_single_samples(moment, by):
    found = moved(by)
    power, gradient = found.powers(batch([Observation(moment, 0.0, found.slope)], 0))
    single = found.predict(moment)
    assert power.shape == (1,) and gradient.shape == (1, SLOPE)
    assert power[0] == pytest.approx(single.power, rel=1e-12, abs=1e-9)
    np.testing.assert_allclose(gradient[0], single.gradient[:SLOPE], rtol=1e-12, atol=1e-9)
    assert found.residual_stds(np.array([moment.speed]))[0] == found.residual_std(moment)


@given(samples, states)
@settings(deadline=None)
def test_data_tell_nothing_in_the_null_direction(moment, by):
    gradient = moved(by).predict(moment).gradient
    assert abs(gradient @ NULL) <= 1e-9 * (np.abs(gradient) @ np.abs(NULL))


def test_one_update_by_hand():
    """Standing still only p_aux is told: a Kalman step on one number.

    Prior 1100 +- 400 W. The sample stands for 0.1 s of 0.5 s, so its variance is 5 * 60^2 =
    18000 W^2, and it reads 1200 W: gain 160000 / 178000, 1100 + 100 * 0.898876 = 1189.888 W,
    variance 160000 * (1 - 0.898876) = 16179.8 W^2.
    """
    found = new()
    moment = sample(0.0)
    found.advance(moment)
    assert found.update(moment, 1200.0, 0.1) == pytest.approx(100.0)
    assert found.parameters().p_aux == pytest.approx(1189.8876)
    assert found.parameter_std().p_aux == pytest.approx(math.sqrt(16179.775))
    assert found.parameters()[:5] == pytest.approx(CAR.initial[:5], rel=1e-12)


def test_sigma_has_all_causes():
    prediction = new().predict(sample(0.0, 10.0))
    assert prediction.residual_std == pytest.approx(math.hypot(POWER_NOISE, 10 * FORCE_NOISE))
    assert prediction.sigma == math.hypot(prediction.parameter_std, prediction.residual_std)


def test_an_outlier_moves_the_estimate_little():
    """Huber: beyond 2.5 sigma the pull grows no more."""

    def pull(residual: float) -> float:
        found = new()
        moment = sample(0.0)
        power = found.predict(moment).power + residual
        found.update(moment, power, 0.5)
        return found.parameters().p_aux - CAR.initial.p_aux

    sigma = new().predict(sample(0.0)).sigma
    assert pull(2 * sigma) == pytest.approx(2 * pull(sigma), rel=1e-9)
    # gain = S / (S + R x) for a residual x times 2.5 sigma: the pull stays below 2.5 sigma S / R.
    most = 2.5 * sigma * 400.0**2 / POWER_NOISE**2
    assert pull(100 * sigma) < most and pull(1e6 * sigma) < most


def test_it_relaxes_to_the_prior_with_its_time_constants():
    found = new()
    found.mean[P_AUX] += 300.0
    found.covariance[P_AUX, P_AUX] = 100.0
    found.advance(sample(0.0))
    found.advance(sample(TIME_CONSTANTS[P_AUX]))  # 1/e of the way is left
    assert found.mean[P_AUX] == pytest.approx(1100.0 + 300.0 / math.e)
    expected = 100.0 / math.e**2 + 160_000.0 * (1 - 1 / math.e**2)
    assert found.covariance[P_AUX, P_AUX] == pytest.approx(expected)


def test_time_that_goes_back_or_jumps_relaxes_nothing():
    found = new()
    found.mean[MASS] += 0.1
    found.advance(sample(1800.0))
    found.advance(sample(0.0))
    found.forget_time()
    found.advance(sample(86_400.0))
    assert found.mean[MASS] == pytest.approx(math.log(1823.0) + 0.1)


def test_after_a_jump_of_time_the_road_may_be_another(synthetic):
    found = learn(new(), synthetic(TRUTH), 0.2)
    before, covariance = found.mean.copy(), found.covariance.copy()
    found.forget_time()
    assert found.mean[SLOPE] == 0.0
    kept = [k for k in range(len(STATES)) if k != SLOPE]
    assert found.mean[kept].tolist() == before[kept].tolist()
    assert found.covariance[np.ix_(kept, kept)].tolist() == covariance[np.ix_(kept, kept)].tolist()
    check_limits(found)


@pytest.mark.parametrize("route", range(4))
def test_it_learns_a_car_without_model_error(synthetic, route):
    """120 s in town. C_rr and drag apart are not told by town speeds: within their sigma."""
    drive = synthetic(TRUTH, route=route, seed=route, noise=0.2, hills=0.0)
    value, std, share = learn(new(), drive, 0.2).identifiable()
    truth = identifiable(TRUTH, CAR.frontal_area)
    assert value.mass_over_eta == pytest.approx(truth.mass_over_eta, rel=0.01)
    assert value.regeneration == pytest.approx(truth.regeneration, rel=0.01)
    assert value.p_aux == pytest.approx(truth.p_aux, rel=0.01)
    for name in ("c_rr", "drag_area_over_eta"):
        error = getattr(value, name) - getattr(truth, name)
        assert abs(error) < 2 * getattr(std, name)
    assert max(share.mass_over_eta, share.regeneration, share.p_aux) < 0.1


def test_the_null_direction_keeps_its_prior(synthetic):
    """No data can tell it: its variance (in the information sense) and mean stay the prior's."""
    found, prior = learn(new(), synthetic(TRUTH), 0.2), new()
    held = [ETA, MU, MASS, 4]  # those with relaxation alike; the rest is not in the direction
    prior_information = np.linalg.inv(prior.covariance[np.ix_(held, held)])
    direction = NULL[held]
    expected = direction @ prior_information @ direction
    # The marginal covariance of the four; what is told of them is orthogonal to the direction.
    information = np.linalg.inv(found.covariance[np.ix_(held, held)])
    assert direction @ information @ direction == pytest.approx(expected, rel=1e-6)
    stretch = direction @ prior_information @ (found.mean - prior.mean)[held]
    assert stretch == pytest.approx(0.0, abs=1e-6 * expected)


def check_limits(found: ParameterFilter) -> None:
    prior = new()
    assert np.isfinite(found.mean).all() and np.isfinite(found.covariance).all()
    variance = np.diag(found.covariance)
    assert (variance <= np.diag(prior.covariance) * (1 + 1e-9)).all() and (variance >= 0).all()
    scale = np.sqrt(np.maximum(np.diag(prior.covariance), 1e-12))
    assert np.linalg.eigvalsh(found.covariance / np.outer(scale, scale))[0] > -1e-9
    assert found.mean[ETA] <= 0.0 and found.mean[MU] <= 0.0
    assert NOISE_RANGE[0] <= found.noise_scale <= NOISE_RANGE[1]


@pytest.mark.parametrize(
    ("seconds", "speed", "noise"), [(3600, 0.0, 20.0), (3 * 3600, 27.0, 1500.0)]
)
def test_hours_without_excitation_wind_nothing_up(synthetic, seconds, speed, noise):
    """A drive in town, then an hour of standing or three hours at one speed, at 1 Hz."""
    found = learn(new(), synthetic(TRUTH, noise=0.5), 0.2)
    before, _, _ = found.identifiable()
    rng = np.random.default_rng(0)
    begin = START_OF_STEADY
    for second in range(seconds):
        moment = sample(begin + second, speed)
        steady = combined_power(
            speed, 0.0, identifiable(TRUTH, CAR.frontal_area), air_density=1.17
        )
        found.advance(moment)
        found.update(moment, steady + noise * rng.standard_normal(), 1.0)
    check_limits(found)
    after, std, _ = found.identifiable()
    # What this tells nothing of goes back to the prior, slower than its sigma grows.
    for name in ("mass_over_eta", "regeneration"):
        drift = getattr(after, name) - getattr(before, name)
        assert abs(drift) < 0.5 * getattr(std, name)


START_OF_STEADY = 1_700_000_000 + 200


@given(
    st.lists(
        st.tuples(
            st.floats(-10.0, 60.0),
            st.floats(-15.0, 15.0),
            st.floats(-3e5, 3e5),
            st.floats(0.001, 1.0),
        ),
        max_size=60,
    ),
    st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_whatever_it_is_told_it_stays_within_its_limits(rows, copper_loss):
    found = new(copper_loss=copper_loss)
    time = 0.0
    for speed, acceleration, power, step in rows:
        time += step
        moment = sample(time, speed, acceleration)
        found.advance(moment)
        found.update(moment, power, step)
        assert found.mean[ETA] <= 0.0 and found.mean[MU] <= 0.0
    if not copper_loss:
        check_limits(found)


def test_more_comes_back_than_can_be():
    """A battery that gives back all of it and more (a tail wind, a hill): eta and mu stop at 1."""
    found = new()
    for k in range(3000):
        acceleration = 1.5 if k % 2 else -1.5
        moment = sample(k / 10, 15.0, acceleration)
        found.advance(moment)
        found.update(moment, 1100.0 + 1900 * 1.03 * 15.0 * acceleration * 1.3, 0.1)
    check_limits(found)
    assert found.parameters().eta == pytest.approx(1.0) and found.parameters().mu <= 1.0


def test_a_round_trip_is_exact_and_what_does_not_fit_is_refused(synthetic):
    found = learn(new(), synthetic(TRUTH, seconds=30.0), 0.2)
    saved = found.export()
    other = new()
    other.restore(saved)
    assert other.export() == saved
    size = len(STATES)
    skewed = (np.array(saved["covariance"]) + np.triu(np.full((size, size), 0.1))).tolist()
    for wrong in (
        {"mean": saved["mean"][:-1]},
        {"mean": [math.nan] * size},
        {"mean": [1e6] * size},
        {"covariance": np.zeros((size, size - 1)).tolist()},
        {"covariance": np.diag([-0.01] * size).tolist()},
        {"covariance": np.diag([1e9] * size).tolist()},
        {"covariance": skewed},
        {"noise_scale": 1e9},
        {"noise_scale": math.nan},
    ):
        with pytest.raises(ValueError, match="saved"):
            other.restore({**saved, **wrong})
    assert other.export() == saved


def test_a_clock_that_is_set_does_not_forget_the_car(synthetic):
    """Fifty years pass at once when a computer without a clock first hears the time."""
    found = learn(new(), synthetic(TRUTH), 0.2)
    before = found.identifiable()[0]
    later = Sample(found._last_ns + 50 * 365 * 86400 * 10**9, 10.0, 0.0, 0.0, 1.17, 0.0)
    found.advance(later)
    after = found.identifiable()[0]
    assert after.mass_over_eta == pytest.approx(before.mass_over_eta, rel=0.01)
    assert after.regeneration == pytest.approx(before.regeneration, rel=0.02)


@given(states)
def test_bounds_are_kept_by_as_few_as_needed(by):
    """Whatever was learned, eta and mu stay at most 1 and auxiliaries draw, never give."""
    found = moved(by)
    rng = np.random.default_rng(0)
    mix = np.diag(np.sqrt(np.diag(found.covariance))) @ rng.standard_normal((len(STATES),) * 2)
    found.covariance = mix @ mix.T
    found.mean[P_AUX] -= 1000.0 * abs(by[0])
    before = found.mean.copy()
    found.limit_states()
    inside = before[0] <= 0.0 and before[1] <= 0.0 and before[P_AUX] >= 0.0
    assert found.mean[0] <= 0.0 and found.mean[1] <= 0.0 and found.mean[P_AUX] >= 0.0
    assert np.array_equal(found.mean, before) == inside
