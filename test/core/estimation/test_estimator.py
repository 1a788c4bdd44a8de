from dataclasses import replace
import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import ParameterSet, PowerKind, Trust
from evpinn_ros.core.estimation.estimator import Activity, Mode
from evpinn_ros.core.signals.interval import DURATION
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.identifiable import identifiable
from test.combined import combined_power

MODES = [Mode.HYBRID, pytest.param(Mode.PAPER, marks=pytest.mark.torch)]
CUT = 70.0  # s, in motion: from there on the battery is silent


def up_to(readings, seconds) -> list:
    end = readings[0].stamp_ns + round(seconds * NANOSECONDS)
    return [reading for reading in readings if reading.stamp_ns < end]


def from_on(readings, seconds) -> list:
    return readings[len(up_to(readings, seconds)) :]


def text(outputs) -> list[str]:
    """NaN is not equal to itself; the text of a number is exact."""
    return [repr(output) for output in outputs]


def test_the_first_predictions_are_the_prior_s(new_estimator, play, powers, vehicle, cruise):
    """With what a drivetrain loses by turning and by force, and stiffer tyres at first."""
    outputs = play(new_estimator(), cruise(0, 2, battery=False))
    cold = vehicle.initial._replace(c_rr=1.15 * vehicle.initial.c_rr)
    combined = identifiable(cold, vehicle.frontal_area)
    driven = combined_power(15.0, 0.0, combined, air_density=1.17)
    force = (driven - vehicle.initial.p_aux) / 15.0 / combined.mass_over_eta  # over the mass
    expected = driven + 150.0 * (0.5 + 0.5 * 15.0 / 10.0) + 200.0 * force**2
    predictions = powers(outputs)
    assert {power.kind for power in predictions} == {PowerKind.PREDICTED, PowerKind.SMOOTHED}
    # Of heat by force what eq. 21 explains is taken away.
    assert all(power.power == pytest.approx(expected, rel=0.02) for power in predictions)


def test_parameters_come_once_a_second(new_estimator, play, cruise):
    readings = cruise(0, 5.7)
    outputs, at_start = play(new_estimator(), readings), readings[0].stamp_ns
    published = [output for output in outputs if isinstance(output, ParameterSet)]
    assert [f.stamp_ns - at_start for f in published] == [k * NANOSECONDS for k in (1, 2, 3, 4, 5)]


@pytest.mark.parametrize(
    ("mode", "slower", "early_ns"),
    [
        (Mode.HYBRID, 1, 0),
        (Mode.HYBRID, 5, 0),
        (Mode.HYBRID, 5, 700_000_000),
        pytest.param(Mode.PAPER, 5, 700_000_000, marks=pytest.mark.torch),
    ],
)
def test_no_prediction_knows_the_battery_of_its_moment_or_later(
    new_estimator, play, powers, drive, mode, slower, early_ns
):
    """The current trebles from a moment on: up to then not one bit differs.

    Also with a battery at 2 Hz, and when it comes long before the speed of its moment.
    """
    readings = up_to(drive(1, 240.0).readings, 14.0)
    cut = readings[0].stamp_ns + 10 * NANOSECONDS
    speeds = [r for r in readings if isinstance(r, SpeedReading)]
    batteries = [r for r in readings if isinstance(r, BatteryReading)][::slower]
    batteries = [b for b in batteries if not math.isnan(b.voltage)]
    changed = [
        replace(b, current=3 * b.current - 1.0) if b.stamp_ns >= cut else b for b in batteries
    ]

    def outputs(given) -> list[str]:
        arrivals = [(r.stamp_ns - early_ns, 0, r) for r in given]
        arrivals += [(r.stamp_ns, 1, r) for r in speeds]
        in_order = [reading for *_, reading in sorted(arrivals, key=lambda a: a[:2])]
        return powers(play(new_estimator(mode=mode), in_order))

    as_it_was, otherwise = outputs(batteries), outputs(changed)
    before = [
        text([p for p in predictions if p.stamp_ns <= cut])
        for predictions in (as_it_was, otherwise)
    ]
    assert before[0] == before[1] and len(before[0]) > 180
    assert text(as_it_was) != text(otherwise)


@pytest.mark.parametrize("mode", MODES)
def test_without_a_battery_predictions_go_on(new_estimator, taught, play, powers, drive, mode):
    """As long with as without; sigma at one and the same sample does not shrink meanwhile."""
    seconds = 20.0 if mode is Mode.HYBRID else 12.0
    readings = up_to(drive(1, 240.0).readings, 2 * seconds)
    if mode is Mode.HYBRID:
        estimator = taught(seconds)
    else:
        estimator = new_estimator(mode=mode)
        play(estimator, up_to(readings, seconds))
    assert estimator.status().activity is Activity.LEARNING
    updates = estimator.status().updates
    silent = [r for r in from_on(readings, seconds) if not isinstance(r, BatteryReading)]
    # The last battery readings are learned once the watermark has passed them by a lag.
    predictions = powers(play(estimator, silent[:12]))
    probe = probe_sigma(estimator)
    predictions += powers(play(estimator, silent[12:]))
    assert len(predictions) > 18 * seconds
    assert all(math.isfinite(p.power) and 0 < p.sigma < math.inf for p in predictions)
    assert probe_sigma(estimator) >= probe
    status = estimator.status()
    assert status.activity is Activity.PREDICTING
    # The paper's window has nothing new; intervals without energy show what they predict.
    assert status.updates <= updates + (4 if mode is Mode.PAPER else seconds / DURATION + 1)


@pytest.mark.slow
@pytest.mark.parametrize("unlearned", ["stuck speed", "pause"])
def test_energy_of_a_dropout_begins_where_the_battery_was_last_measured(
    taught, play, powers, drive, unlearned
):
    """Also where what was measured before it taught nothing; and it has no end."""
    readings = list(up_to(drive(1, 240.0).readings, 170.0))
    begin_ns, estimator = readings[0].stamp_ns, taught(40.0)
    estimator.enabled = unlearned != "pause"
    held = next(r.speed for r in from_on(readings, CUT) if isinstance(r, SpeedReading))
    before = [
        replace(r, speed=held) if unlearned != "pause" and isinstance(r, SpeedReading) else r
        for r in from_on(up_to(readings, CUT), 40.0)
    ]
    play(estimator, before)
    silent = [r for r in from_on(readings, CUT) if not isinstance(r, BatteryReading)]
    predictions = [p for p in powers(play(estimator, silent)) if math.isfinite(p.energy)]
    first, last = predictions[0], predictions[-1]
    assert (first.stamp_ns - begin_ns) / NANOSECONDS < CUT + 2.0
    assert abs(first.energy) < 2.0 * 15_000.0  # J: of two seconds
    seconds = np.diff([p.stamp_ns for p in predictions]) / NANOSECONDS
    drawn = float(np.array([p.power for p in predictions[1:]]) @ seconds)
    assert last.energy - first.energy == pytest.approx(drawn, abs=3 * last.energy_sigma)


def probe_sigma(estimator) -> float:
    """Sigma at 10 m/s, band included, without letting time pass."""
    moment = Sample(estimator.status().newest_ns, 10.0, 0.2, 0.0, 1.17, 0.0)
    _, sigma = estimator._learner.predict(moment)
    return sigma * estimator._bands[PowerKind.SMOOTHED].scale(moving=True)


@pytest.mark.slow
def test_parameters_are_stale_after_five_minutes_of_silence(taught, play, drive, cruise):
    estimator, readings = taught(230.0), drive(1, 240.0).readings
    assert estimator.parameters().identifiable_trust["mass_over_eta"] is Trust.VALID
    eta = estimator.parameters().parameters["eta"].trust
    begin = (readings[0].stamp_ns - cruise(0, 1)[0].stamp_ns) / NANOSECONDS + 230.0
    for seconds, state in ((299.0, Trust.VALID), (302.0, Trust.STALE)):
        play(estimator, cruise(begin + seconds - 1, begin + seconds, battery=False))
        published = estimator.parameters()
        assert published.identifiable_trust["mass_over_eta"] is state
        assert published.parameters["eta"].trust is (state if eta is Trust.VALID else eta)


def test_reverse_and_charging_teach_nothing_and_stay_counted(new_estimator, play, cruise):
    estimator = new_estimator()
    before = estimator.export()
    play(estimator, cruise(0, 10, speed=-2.0, power=30e3))
    play(estimator, cruise(10, 20, speed=0.0, power=-7000.0))
    estimator.flush()
    status = estimator.status()
    # The first half second of standing is smoothed with reversing before it.
    assert status.gated["reverse"] + status.gated["charging"] >= 190
    assert estimator.export()["learner"]["car"] == before["learner"]["car"]
    estimator.restore(before)
    assert estimator.status().gated == status.gated


@pytest.mark.parametrize("mode", MODES)
def test_paused_it_predicts_and_does_not_learn(new_estimator, play, powers, drive, mode):
    readings = up_to(drive(1, 240.0).readings, 16.0)
    estimator = new_estimator(mode=mode)
    play(estimator, up_to(readings, 12.0))
    estimator.enabled = False

    def noted():  # changes with every sample learned from
        learner = estimator.export()["learner"]
        return learner.get("variance") or estimator._learner._trim.weights.tolist()

    before, updates = noted(), estimator.status().updates
    assert powers(play(estimator, from_on(readings, 12.0)))
    status = estimator.status()
    assert status.activity is Activity.PAUSED
    assert (noted(), status.updates) == (before, updates)
    estimator.enabled = True
    assert estimator.status().activity is Activity.LEARNING


def test_what_was_driven_in_a_pause_is_not_learned_after_it(new_estimator, play, cruise):
    estimator = new_estimator()
    before, estimator.enabled = estimator.export()["learner"]["car"], False
    play(estimator, cruise(0, 13))
    assert not any(estimator.status().seen.values())
    estimator.enabled = True
    play(estimator, cruise(13, 15))  # two updates, before the next ten seconds are over
    assert estimator.export()["learner"]["car"] == before
    assert any(estimator.status().seen.values())


def test_a_reset_forgets_what_was_learned_and_keeps_counters(new_estimator, play, drive):
    readings = up_to(drive(1, 240.0).readings, 15.0)
    estimator, fresh = new_estimator(), new_estimator()
    first = play(estimator, readings)
    updates = estimator.status().updates
    estimator.reset()
    assert text([estimator.parameters()]) == text([fresh.parameters()])
    assert text(play(estimator, readings)) == text(first)
    assert estimator.status().updates == 2 * updates > 0


def test_a_time_jump_keeps_what_was_learned(taught, play, powers, drive):
    readings, estimator = drive(1, 240.0).readings, taught(20.0)
    before = estimator.parameters().identifiable
    estimator.handle_time_jump()
    # All but p_aux: what is switched on may be something else now.
    assert estimator.parameters().identifiable[:4] == before[:4]
    outputs = powers(play(estimator, up_to(readings, 10.0)))  # the same stamps again
    assert outputs[0].stamp_ns <= readings[0].stamp_ns + NANOSECONDS
    assert len(outputs) > 180 and not estimator.status().dropped
