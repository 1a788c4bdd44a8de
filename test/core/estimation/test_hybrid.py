"""The online learner: what it predicts, and what it takes of an update."""

from copy import deepcopy
from dataclasses import replace
import json
import math
from typing import NamedTuple

import numpy as np
import pytest

from evpinn_ros.core.estimation.hybrid import PARKED_NS, HybridLearner
from evpinn_ros.core.estimation.learner import Span, joined_predictions
from evpinn_ros.core.estimation.states import LASTING, NAMES, State
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.kinematics import PROFILE
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import NO_NS, NO_SAMPLES, Sample, Samples
from evpinn_ros.core.signals.track import NEVER
from evpinn_ros.replays.simulation.drive import DriveKind

STEP = NANOSECONDS // 10


def sample(tick: int, speed=15.0, **others) -> Sample:
    values = {"profile": (0.0,) * PROFILE, **others}
    return Sample(tick * STEP, speed, 0.0, 0.0, 1.17, 0.0, **values)


class Predicted(NamedTuple):
    power: float
    sigma: float
    energy: float
    energy_sigma: float


def span(**columns) -> Span:
    """A span of these columns alone."""
    return replace(
        Span(NO_SAMPLES, NO_NS, NO_NS, NO_SAMPLES, NO_SAMPLES, np.empty(0), NO_NS, NO_NS),
        **columns,
    )


def predicted(learner: HybridLearner, tick: int) -> Predicted:
    """The prediction of a smoothed sample, up to which time passes."""
    told_ns = np.array([getattr(learner, "told_ns", NEVER)])
    outputs = learner.follow(span(smoothed=Samples.of([sample(tick)]), battery_ns=told_ns))
    return Predicted(*outputs.smoothed[0], *outputs.energies[0])


def battery_measured(learner: HybridLearner, tick: int) -> None:
    learner.told_ns = sample(tick).stamp_ns  # of the last reading, which goes with each span


def observe(learner: HybridLearner, moment: Sample, power: float) -> None:
    """Let it learn from a measured sample."""
    measured = Samples.of([moment])
    learner.follow(span(measured=measured, power=np.array([power]), place=np.zeros(1, np.int64)))


@pytest.fixture(scope="module")
def town(vehicle, as_prior):
    """Two minutes of a car like the prior, measured."""
    return as_prior(equation_of(vehicle), (DriveKind.URBAN, 120.0, 0))


@pytest.fixture(scope="module")
def learned(vehicle, town) -> HybridLearner:
    taught = HybridLearner(vehicle)
    for interval in town:
        taught.add_interval(interval)
    assert taught.consider(taught.prepare_update()()) is None
    return taught


@pytest.fixture
def learner(learned) -> HybridLearner:
    return deepcopy(learned)


def test_an_update_works_on_a_copy_and_a_snapshot(learner, town, vehicle):
    before = json.dumps(learner.export())
    learner.add_interval(town[0])
    work = learner.prepare_update()
    learner.add_interval(town[1])
    first, again = work(), work()
    assert json.dumps(learner.export()) == before
    assert np.array_equal(first.state.mean, again.state.mean)
    assert learner.consider(first) is None and json.dumps(learner.export()) != before
    assert learner.prepare_update() is not None, "the second interval still waits"
    assert learner.prepare_update() is None


def test_one_by_one_and_all_at_once_are_the_same(vehicle, town, learner):
    other = HybridLearner(vehicle)
    for interval in town:
        other.add_interval(interval)
        other.consider(other.prepare_update()())
    assert other.export() == learner.export()


def test_what_is_not_finite_or_of_a_drive_that_ended_is_not_taken(learner, town):
    learner.add_interval(town[0])
    candidate = learner.prepare_update()()
    state = candidate.state
    broken = replace(candidate, state=replace(state, mean=state.mean * math.nan))
    before = json.dumps(learner.export())
    assert learner.consider(broken) == "not_finite"
    assert json.dumps(learner.export()) == before
    # The car parks while the update is under way: it may not bring the last drive back.
    predicted(learner, 0)
    predicted(learner, PARKED_NS // STEP + 10)
    assert learner._car.state.intervals == 0
    assert learner.consider(candidate) == "outdated"
    assert learner._car.state.intervals == 0


@pytest.mark.parametrize(
    ("seconds", "same"),
    [(3.0, True), (-3.0, True), (-300.0, True), (900.0, False), (-900.0, False)],
)
@pytest.mark.parametrize("jumped", [True, False])
def test_a_clock_that_is_set_right_ends_no_drive(learner, seconds, same, jumped):
    """`jumped`: the stream saw the jump and had the window forgotten."""
    predicted(learner, 20_000)
    before = learner._car.state.mean[:, LASTING]
    if jumped:
        learner.forget_window()
    predicted(learner, 20_000 + round(10 * seconds))
    assert (learner._car.state.intervals > 0) == same
    after = learner._car.state.mean[:, LASTING]
    np.testing.assert_allclose(after, before, rtol=1e-9)


def test_the_breakdown_goes_on_over_a_long_stop_and_begins_with_another_drive(learner):
    """A log of some trips, with hours between them: its breakdown is of all of them."""
    predicted(learner, 0)
    before = learner.breakdowns().of(-1)
    predicted(learner, PARKED_NS // STEP + 10)
    assert learner._car.state.intervals == 0
    after = learner.breakdowns().of(-1).energy
    # What is of the first part alone is as the states of the car say of it.
    assert after == pytest.approx(before.energy, rel=0.05, abs=10.0)
    learner.end_drive()
    assert learner.breakdowns().of(-1) is None


def test_the_breakdown_is_that_of_the_present_car_however_often_it_is_asked_for(vehicle, town):
    learner, others = HybridLearner(vehicle), HybridLearner(vehicle)
    told = []
    for interval in town:
        for taught in (learner, others):
            taught.add_interval(interval)
            assert taught.consider(taught.prepare_update()()) is None
        told.append(learner.together(()).of(0).measured)
        assert learner.together(()).of(0).measured == told[-1]
    assert told == pytest.approx(np.cumsum([interval.energy for interval in town]))
    last = learner.together(()).of(0)
    np.testing.assert_array_equal(last.energy, others.together(()).of(0).energy)
    learner.end_drive()
    assert learner.together(()).of(0) is None


def test_a_silent_battery_gives_energy_with_a_sigma_and_its_return_ends_that(learner, town):
    silent = [
        replace(
            interval,
            energy=math.nan,
            start_ns=interval.start_ns + 200 * NANOSECONDS,
            end_ns=interval.end_ns + 200 * NANOSECONDS,
        )
        for interval in town
    ]
    predicted(learner, 0)
    sigmas = []
    for interval in silent:
        learner.add_interval(interval)
        learner.consider(learner.prepare_update()())
        sigmas.append(predicted(learner, interval.end_ns // STEP).energy_sigma)
    total = predicted(learner, silent[-1].end_ns // STEP + 1).energy
    truth = sum(interval.energy for interval in town)
    assert sigmas[-1] > sigmas[0] > 0.0 and abs(total - truth) < 2 * sigmas[-1]
    learner.add_interval(replace(silent[-1], energy=town[-1].energy))
    learner.consider(learner.prepare_update()())
    battery_measured(learner, 9000)
    assert math.isnan(predicted(learner, 9001).energy)


@pytest.fixture(scope="module")
def drew_more(learned) -> HybridLearner:
    """For a minute, to its tick 600, the car drew 3 kW more than it does alone."""
    heavier = deepcopy(learned)
    alone = predicted(deepcopy(heavier), 0).power
    for tick in range(1, 600):
        predicted(heavier, tick)
        battery_measured(heavier, tick)
        observe(heavier, sample(tick), alone + 3000.0)
    return heavier


def test_a_dropout_begins_with_what_the_last_seconds_had_beyond_the_car(learner, drew_more):
    """Energy of its first seconds is the integral of the power that is published."""
    alone, learner = predicted(deepcopy(learner), 0).power, deepcopy(drew_more)
    predictions = [predicted(learner, tick) for tick in range(600, 630)]
    assert predictions[0].power - alone > 1000.0
    assert predictions[-1].energy == pytest.approx(
        0.1 * sum(prediction.power for prediction in predictions), rel=0.03
    )


def test_of_a_step_that_the_battery_saw_in_part_the_rest_counts(drew_more):
    learner = deepcopy(drew_more)
    predicted(learner, 610)
    battery_measured(learner, 619)
    first, second = predicted(learner, 620), predicted(learner, 630)
    assert second.energy == pytest.approx(0.1 * first.power + second.power, rel=0.03)


def newest(learner: HybridLearner, *moments: Sample) -> np.ndarray:
    """Predictions of newest moments, shape (n, 2)."""
    places = np.zeros(len(moments), np.int64)
    columns = {"newest_place": places, "newest_learned": places}
    return learner.follow(span(newest=Samples.of(moments), **columns)).newest


def test_the_newest_sample_is_predicted_and_nothing_follows_it(learner):
    first, again = newest(learner, sample(5), sample(5))
    assert first.tolist() == again.tolist()
    assert first.tolist() == pytest.approx(learner.predict(sample(5)), rel=1e-12)


def test_samples_before_a_jump_of_time_are_in_no_energy(learner):
    without = deepcopy(learner)
    for tick in range(20):
        battery_measured(learner, tick)
        predicted(learner, tick)
    learner.forget_window()
    learner.told_ns = NEVER
    without.forget_window()
    for tick in (100, 101, 102):
        expected = predicted(without, tick).energy
        assert predicted(learner, tick).energy == pytest.approx(expected, rel=1e-9, nan_ok=False)


def test_a_standing_car_teaches_the_trim_nothing(learner):
    before = newest(learner, sample(2)).tolist()
    observe(learner, sample(1, speed=0.05), 9000.0)
    assert newest(learner, sample(2)).tolist() == before


def saved_car(learner) -> dict:
    return json.loads(json.dumps(learner.export()))


def test_a_state_is_kept_and_what_does_not_fit_is_refused(learner, vehicle):
    saved = saved_car(learner)
    other = HybridLearner(vehicle)
    other.restore(saved)
    assert saved_car(other) == saved
    assert other.parameters().identifiable == learner.parameters().identifiable
    fresh = HybridLearner(vehicle)
    before = saved_car(fresh)
    car, uneven = saved["car"], saved["uneven"]
    for wrong in (
        {"car": {}},
        {"car": {**car, "names": car["names"][1:]}},
        {"car": {**car, "mean": [[math.nan] * len(NAMES)] * len(car["mean"])}},
        {"uneven": {**uneven, "by_drives": uneven["by_drives"][:-1]}},
        {"uneven": {**uneven, "squares": 1e30}},
    ):
        with pytest.raises((KeyError, TypeError, ValueError)):
            fresh.restore({**saved, **wrong})
    assert saved_car(fresh)["car"] == before["car"]


def test_a_car_saved_before_hills_were_known_goes_on(learner, vehicle):
    saved = saved_car(learner)
    del saved["hills"]
    other = HybridLearner(vehicle)
    other.restore(saved)
    assert other.parameters().identifiable == learner.parameters().identifiable


def test_a_car_that_forecasts_is_the_car_that_was_learned(learner):
    car = learner.model()
    assert np.isfinite(car.mean).all() and np.isfinite(car.covariance).all()
    published = learner.parameters().identifiable
    assert car.mean[State.MASS_OVER_ETA] == pytest.approx(published.mass_over_eta, rel=0.05)
    learner.end_drive()
    assert learner.model().seconds == 0.0


def test_each_kind_of_samples_is_predicted_from_its_own(vehicle):
    """They are computed together: at 10 and 20 m/s as each alone, in either order."""
    slow, fast = (Samples.of([sample(0, speed)]) for speed in (10.0, 20.0))
    one = np.zeros(1, np.int64)

    def powers(newest, smoothed):
        columns = {"newest_place": one[: newest.size], "newest_learned": one[: newest.size]}
        battery_ns = one[: smoothed.size]
        both = span(newest=newest, smoothed=smoothed, battery_ns=battery_ns, **columns)
        predictions = HybridLearner(vehicle).follow(both)
        return np.concatenate((predictions.newest, predictions.smoothed))

    alone = np.concatenate((powers(slow, NO_SAMPLES), powers(fast, NO_SAMPLES)))
    assert alone[1, 0] > 1.5 * alone[0, 0]
    np.testing.assert_allclose(powers(slow, fast), alone, rtol=1e-12)
    np.testing.assert_allclose(powers(fast, slow), alone[::-1], rtol=1e-12)


def test_a_span_that_is_cut_is_followed_as_the_whole(drew_more):
    """Also where a pause within it begins another drive."""
    rng = np.random.default_rng(0)
    ticks = np.append(600 + np.arange(40), 600 + PARKED_NS // STEP + np.arange(20))
    smoothed = Samples.of([sample(tick) for tick in ticks.tolist()])
    place = np.arange(3, 60)
    whole = span(
        newest=smoothed,
        newest_place=np.arange(60),
        newest_learned=np.maximum(np.arange(60) - 3, 0),
        smoothed=smoothed,
        measured=smoothed.where(slice(0, 57)),
        power=10e3 + 500.0 * rng.normal(size=57),
        place=place,
        battery_ns=np.full(60, sample(600).stamp_ns),
    )
    together = deepcopy(drew_more).follow(whole)
    for cut in (1, 20, 41, 59):
        learner = deepcopy(drew_more)
        parts = joined_predictions([learner.follow(part) for part in whole.cut(cut)])
        for column, same in zip(parts, together, strict=True):
            np.testing.assert_allclose(column, same, rtol=1e-9)
