"""Scores against values worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.replays.history import Drive, PowerSeries
from evpinn_ros.replays.scoring import (
    Span,
    baseline_scores,
    energy_score,
    held_scores,
    known_at,
    power_score,
    speed_floor,
)
from test.replays.conftest import made


def drive(measured, predicted, *, sigma=100.0, energy=None) -> Drive:
    """A drive of one reading and one prediction a second."""
    time = np.arange(float(len(predicted)))
    ones = np.ones(len(time))
    series = PowerSeries(time, np.array(predicted, float), sigma * ones, 0.3 * ones)
    rows = np.column_stack((np.arange(float(len(measured))), np.array(measured, float)))
    counted = np.zeros((0, 3)) if energy is None else np.array(energy, float)
    return made(measured=rows, smoothed=series, newest=series, energy=counted)


WHOLE = Span(-1.0, 1e9)


def test_power_score_by_hand():
    # Errors +100, -100, +300, -300 W; truth 0, 1000, 2000, 3000 W has variance 1.25e6 W^2.
    scored = drive([0, 1000, 2000, 3000], [100, 900, 2300, 2700], sigma=100.0)
    score = power_score(scored, scored.smoothed, WHOLE)
    assert score["rmse_w"] == pytest.approx(np.sqrt((2 * 100**2 + 2 * 300**2) / 4))
    assert score["mae_w"] == pytest.approx(200.0)
    assert score["r2"] == pytest.approx(1 - 5e4 / 1.25e6)
    # The band is 1.645 * 100 W = 164 W: it holds two of four.
    assert score["coverage_90"] == 0.5


def test_warm_up_and_withheld_part_are_not_scored():
    scored = drive([0, 0, 0, 0], [9, 9, 1, 9])
    assert power_score(scored, scored.smoothed, Span(1.0, 2.0))["rmse_w"] == 1.0


def test_nothing_measured_gives_null_not_zero():
    scored = drive([], [1, 2, 3])
    assert set(power_score(scored, scored.smoothed, WHOLE).values()) == {None}


def test_power_is_not_known_across_a_gap():
    scored = drive([0, 0, 0, 0, 0, 0], [0])
    rows = np.array([[0.0, 1.0], [1.0, 1.0], [9.0, 1.0], [10.0, 1.0]])
    gappy = replace(scored, measured=rows)
    _, known = known_at(gappy.measured, np.array([0.5, 5.0, 9.5, 11.0]))
    assert known.tolist() == [True, False, True, False]


def test_energy_is_compared_over_the_same_stretch():
    # 1000 W measured from 0 to 4 s, predictions from 1 to 3 s only: 2000 J against 2100 J.
    energy = [[1.0, 0.0, 0.0], [2.0, 1050.0, 1000.0], [3.0, 2100.0, 2020.0]]
    score = energy_score(drive([1000] * 5, [0], energy=energy), WHOLE)
    assert score["measured_j"] == pytest.approx(2000.0)
    assert score["error_percent"] == pytest.approx(5.0)
    assert score["rknn_error_percent"] == pytest.approx(1.0)


def test_baselines_by_hand():
    scored = drive(list(range(100)), [0])
    baselines = baseline_scores(scored, WHOLE)
    assert baselines["last_value"] == pytest.approx(1.0)  # a ramp of 1 W per reading
    assert baselines["interpolation"] == pytest.approx(0.0, abs=1e-9)  # and linear in time


def test_a_hole_in_the_battery_is_left_out_of_both_energies():
    # 1000 W throughout; the battery is silent from 3 to 10 s, the prediction goes on.
    energy = [[float(t), 1000.0 * t, 1000.0 * t] for t in range(14)]
    whole = drive([1000] * 14, [0], energy=energy)
    rows = np.array([[float(t), 1000.0] for t in (0, 1, 2, 3, 10, 11, 12, 13)])
    gappy = replace(whole, measured=rows)
    score = energy_score(gappy, WHOLE)
    assert score["measured_j"] == pytest.approx(6000.0)
    assert score["error_percent"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("charged_w", [-3000.0, -50_000.0])
@pytest.mark.parametrize("standing_w", [0.0, 400.0])
def test_what_a_charger_gives_is_no_error_of_a_prediction(charged_w, standing_w):
    """1000 W for 6 s, then a charger, beside what is predicted for a car that stands."""
    rates = [1000.0] * 6 + [standing_w] * 20
    energy = [[float(t), sum(rates[:t]), sum(rates[:t])] for t in range(26)]
    charging = drive([1000] * 6 + [charged_w] * 20, [0], energy=energy)
    speed = np.column_stack((np.arange(26.0), np.repeat([9.0, 0.0], [6, 20])))
    score = energy_score(replace(charging, speed=speed), WHOLE)
    assert score["measured_j"] == pytest.approx(5000.0)
    assert score["error_percent"] == pytest.approx(0.0, abs=1e-9)
    moving = replace(charging, speed=np.column_stack((np.arange(26.0), np.full(26, 9.0))))
    assert energy_score(moving, WHOLE)["measured_j"] < 0.0  # downhill


def test_the_floor_is_what_no_function_of_speed_explains():
    rng = np.random.default_rng(1)
    speed = rng.uniform(0.0, 30.0, 20_000)
    rest = rng.choice([-2000.0, 2000.0], speed.size)
    power = 500.0 * speed + 20.0 * speed**2 + rest
    noisy = drive(power, np.zeros(speed.size))
    noisy = replace(noisy, speed=np.stack((noisy.smoothed.time, speed), axis=1))
    assert speed_floor(noisy, WHOLE) == pytest.approx(2000.0, rel=0.02)
    assert speed_floor(noisy, Span(-1.0, 400.0)) is None  # too few samples for its bins
    # Power that speed determines leaves what it varies by within a bin.
    alone = replace(noisy, measured=np.stack((noisy.measured[:, 0], power - rest), axis=1))
    assert speed_floor(alone, WHOLE) < 350.0


def test_a_held_value_is_scored_by_its_age():
    time = np.arange(0.0, 300.0, 0.1)
    for step, ages in ((1, [0.1, 1.0, 10.0]), (50, [5.0])):
        rows = np.column_stack((time, 1e3 * time))[::step]
        scores = held_scores(replace(drive([], []), measured=rows), Span(100.0, 300.0))
        assert list(scores) == pytest.approx(ages)
        assert list(scores.values()) == pytest.approx([1e3 * age for age in ages])
