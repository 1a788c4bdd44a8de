import json
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.meter import EnergyMeter, Integrator
from evpinn_ros.core.energy.quadrature import MAX_GAP
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.energy.uncertainty import LASTING_SHARE
from evpinn_ros.core.estimation.outputs import NO_POWERS, PowerRows

RKNN = load_rknn()
START = 1_700_000_000_000_000_000
NEVER = range(0)


SEAM = 1.2e3  # J: the energy of one sample, where measured and predicted energy join


def powers_at(stamps, *values):
    return PowerRows(stamps, stamps, *values)


class Fed(EnergyMeter):
    """A meter that is given sample by sample."""

    last_dropout = None

    @property
    def state(self):
        """The state at the newest stamp."""
        return next(self.course.states(self.course.end).rows())

    def add_measured(self, stamp_ns, power, sigma=math.nan):
        row = (stamp_ns, power, sigma, math.nan, math.nan)
        self.add(NO_POWERS, powers_at(*(np.array([value]) for value in row)))

    def add_predicted(self, stamp_ns, power, sigma, energy_sigma=math.nan, energy=math.nan):
        row = (stamp_ns, power, sigma, energy, energy_sigma)
        self.add(powers_at(*(np.array([value]) for value in row)), NO_POWERS)


def meter(**settings):
    return Fed(RKNN, **settings)


def drive(
    to,
    seconds,
    *,
    measured=10e3,
    predicted=11e3,
    silent=NEVER,
    blind=NEVER,
    sigma=1e3,
    measured_sigma=math.nan,
):
    """Push 10 Hz samples for the seconds of a range, in a block.

    No battery in those of `silent`, and no speed, so no prediction, in those of `blind`.
    """
    ticks = np.arange(seconds.start * 10, seconds.stop * 10 + 1)

    def block(power, sigma, missing):
        at = ticks[(ticks / 10 <= missing.start) | (ticks / 10 > missing.stop)]
        values = (np.full(len(at), value) for value in (power, sigma, math.nan, math.nan))
        return powers_at(START + at * 100_000_000, *values)

    powers = block(predicted, sigma, blind), block(measured, measured_sigma, silent)
    for dropout in to.add(*powers).ended:
        to.last_dropout = dropout
    return to


def test_both_integrals_by_hand():
    state = drive(meter(), range(60)).state
    assert state.stamp_ns == START + 60_000_000_000
    assert state.measured == pytest.approx((600e3, 10e3, math.nan), nan_ok=True)
    assert state.predicted[:2] == pytest.approx((660e3, 11e3))
    assert state.rknn[:2] == pytest.approx((660e3, 11e3), rel=1e-4)
    assert state.predicted.sigma == pytest.approx(math.sqrt(2 * 5 * (60 - 5)) * 1e3, rel=1e-3)
    assert state.regenerated[:2] == (0.0, 0.0)
    assert state.measuring and state.unmeasured_s == 0.0


def test_a_silent_battery_stops_only_what_is_measured():
    silent = drive(meter(), range(60), silent=range(20, 60))
    state = silent.state
    assert not state.measuring
    assert state.measured.energy == pytest.approx(200e3)
    assert math.isnan(state.measured.power)
    assert state.predicted.energy == pytest.approx(660e3)
    assert state.unmeasured_s == pytest.approx(40.0)
    assert state.consumed == pytest.approx(200e3 + 40 * 11e3, abs=SEAM)


def test_silence_is_declared_after_the_timeout():
    late = drive(meter(), range(10))
    late.add_predicted(START + 11_900_000_000, 11e3, 1e3)
    assert late.state.measuring
    late.add_predicted(START + 12_100_000_000, 11e3, 1e3)
    assert not late.state.measuring


@settings(max_examples=20)
@given(slow=st.integers(1, 100), cuts=st.integers(1, 50))
def test_a_battery_that_is_slow_is_counted_as_one_that_is_not(slow, cuts):
    """Ticks of 0.1 s; what is predicted is true, so each moment has one energy, known then."""
    powers = 10e3 + 5e3 * np.sin(np.arange(600) / 30.0)
    stamps, unknown = START + np.arange(600) * 100_000_000, np.full(600, math.nan)
    metered = meter()
    for ticks in np.array_split(np.arange(600), cuts):
        told = ticks[ticks % slow == 0]
        blocks = (
            powers_at(stamps[at], powers[at], np.full(len(at), 1.0), *unknown[[at, at]])
            for at in (ticks, told)
        )
        course = metered.add(*blocks)
        states = course.states(course.up_to(course.predicted.stamp_ns))
        truth = np.append(0.0, np.cumsum(powers[1:] + powers[:-1]) / 2 * 0.1)[ticks]
        held = 15e3 * MAX_GAP  # since the last battery reading
        assert (abs(states.consumed - truth) < held + 3 * states.consumed_sigma).all()


@pytest.mark.parametrize("cut", [3, 6, 20])
def test_a_dropout_begins_at_the_last_reading_between_two_predictions(cut):
    """Predictions each second, of which the battery falls silent in the middle of a step."""
    metered = meter()
    predicted_ns = START + np.arange(21) * 1_000_000_000
    measured_ns = START + np.arange(12) * 500_000_000  # up to 5.5 s
    for first, last in ((0, cut), (cut, 21)):
        ours = slice(first, last)
        begin_ns, end_ns = predicted_ns[[max(first - 1, 0), last - 1]]
        told = measured_ns[(measured_ns > begin_ns - (first == 0)) & (measured_ns <= end_ns)]
        blocks = (
            powers_at(at, np.full(len(at), 10e3), *np.full((3, len(at)), math.nan))
            for at in (predicted_ns[ours], told)
        )
        metered.add(*blocks)
    assert metered.state.consumed == pytest.approx(200e3, rel=1e-4)


def test_a_battery_that_returns_is_bridged_by_the_prediction():
    state = drive(meter(), range(60), silent=range(20, 40)).state
    assert state.measuring
    assert state.measured.energy == pytest.approx(400e3, abs=SEAM)
    assert state.unmeasured_s == pytest.approx(20.1)
    assert state.consumed == pytest.approx(400e3 + 220e3, abs=2 * SEAM)
    assert state.gaps == 1


@pytest.mark.slow
def test_sigma_grows_while_silent_and_does_not_shrink_when_the_battery_returns():
    """The lasting 6 % of the gross energy counts for the silence alone."""
    driven = drive(meter(), range(100), measured_sigma=10.0)
    speaking = driven.state
    drive(driven, range(100, 400), silent=range(100, 400), measured_sigma=10.0)
    silent = driven.state
    assert silent.consumed_sigma == pytest.approx(
        math.hypot(LASTING_SHARE * 300 * 11e3, math.sqrt(2 * 5 * 295) * 1e3), rel=1e-2
    )
    assert silent.predicted.sigma > silent.consumed_sigma > 20 * speaking.consumed_sigma
    later = drive(driven, range(401, 440), measured_sigma=10.0).state
    assert later.consumed_sigma == pytest.approx(silent.consumed_sigma, rel=1e-2)
    assert driven.last_dropout.sigma == pytest.approx(silent.consumed_sigma, rel=1e-2)


def test_time_without_battery_and_speed_is_counted_and_nothing_is_drawn_across_it():
    driven = drive(meter(), range(140), silent=range(20, 120), blind=range(40, 80))
    state = driven.state
    assert state.unknown_s == pytest.approx(40.0, abs=0.3)
    assert state.unmeasured_s == pytest.approx(100.0, abs=0.3)
    assert state.consumed == pytest.approx(40 * 10e3 + 60 * 11e3, abs=2 * SEAM)
    assert driven.last_dropout.unknown_s == pytest.approx(40.0, abs=0.3)


def test_regenerated_is_measured_then_predicted():
    driven = drive(
        meter(), range(30), measured=-5e3, predicted=-4e3, silent=range(10, 30), measured_sigma=0.0
    )
    state = driven.state
    assert state.regenerated.energy == pytest.approx(10 * 5e3 + 20 * 4e3, abs=SEAM)
    assert state.regenerated.power == 4e3
    assert state.regenerated.sigma == state.consumed_sigma  # a part of it
    assert state.predicted.energy == pytest.approx(-30 * 4e3)


def test_what_cannot_be_used_is_counted():
    faulty = drive(meter(), range(10))
    before = faulty.state
    faulty.add_predicted(START, 1e3, 1e3)
    faulty.add_measured(START, 1e3)
    faulty.add_measured(START + 10_000_000_000, 1e3)
    faulty.add_predicted(START + 10_100_000_000, math.nan, 1e3)
    state = faulty.state
    assert state.dropped == 4
    assert state.measured == pytest.approx(before.measured, nan_ok=True)
    assert state.predicted == before.predicted
    assert state.consumed == before.consumed


def test_reset_allows_time_to_start_over():
    again = drive(meter(), range(20))
    again.reset()
    assert again.state.predicted.energy == 0.0
    state = drive(again, range(10)).state
    assert state.measured.energy == pytest.approx(100e3)
    assert (state.dropped, state.gaps) == (0, 0)


@pytest.mark.parametrize("integrator", Integrator)
def test_a_silence_is_bridged_by_the_integrator_chosen(integrator):
    state = drive(meter(integrator=integrator), range(60), silent=range(-1, 60)).state
    chosen = state.rknn if integrator is Integrator.RKNN else state.predicted
    assert state.predicted.energy != state.rknn.energy
    assert state.consumed == chosen.energy


@pytest.mark.parametrize("silent", [NEVER, range(10, 30), range(10, 20), range(-1, 30)])
def test_saved_and_restored_it_goes_on(silent):
    first = drive(meter(), range(30), silent=silent)
    second = meter()
    second.restore(json.loads(json.dumps(first.export())))
    before, after = first.state, second.state
    for name in ("measured", "predicted", "rknn", "regenerated"):
        assert getattr(after, name).energy == pytest.approx(getattr(before, name).energy)
    assert after.predicted.sigma == pytest.approx(before.predicted.sigma)
    assert after.consumed == pytest.approx(before.consumed)
    assert after.unmeasured_s == pytest.approx(before.unmeasured_s)
    later = drive(second, range(40_000, 40_010)).state
    assert later.predicted.energy == pytest.approx(before.predicted.energy + 110e3)
    assert later.consumed == pytest.approx(before.consumed + 100e3)
    assert later.gaps == before.gaps
