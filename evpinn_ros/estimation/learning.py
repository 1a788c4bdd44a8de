"""One interval, learned: rows of the equation, what the bus reports, the battery's energy."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from evpinn_ros.estimation.journey import Journey, Learned
from evpinn_ros.estimation.noise import journey_of, speed_squared, unseen_of
from evpinn_ros.estimation.posterior import (
    CarState,
    advance,
    condition,
    see_motor,
    see_reported_climate,
)
from evpinn_ros.estimation.states import SIZE
from evpinn_ros.estimation.terms import Equation, Warmth, climate_powers
from evpinn_ros.signals.interval import Interval


class PassedInterval(NamedTuple):
    """An interval by the equation of a car.

    Attributes:
        interval: what was driven.
        rows: of its steps, shape (n, SIZE).
        journey: their sum.
        warmth: of tyres and cabin.
    """

    interval: Interval
    rows: np.ndarray
    journey: Journey
    warmth: Warmth


def passed(equation: Equation, interval: Interval, seconds: float) -> PassedInterval:
    """An interval by the equation of a car, so many s after the start of a drive."""
    warmth = Warmth.after(seconds)
    rows = equation.rows(interval.steps, interval.conditions, warmth)
    return PassedInterval(interval, rows, journey_of(interval, rows.sum(0)), warmth)


def learn(state: CarState, equation: Equation, done: PassedInterval) -> tuple[CarState, Learned]:
    """The state after an interval whose battery was measured, and its innovation."""
    interval, _, journey, warmth = done
    conditions = interval.conditions
    state = replace(
        advance(state, interval.duration, unseen_of(interval)),
        celsius=conditions.celsius,
        reports=state.reports or conditions.load > 0.0,
    )
    if interval.steps.motor_known:
        seen = equation.motor_rows(interval.steps, conditions, warmth)
        state = see_motor(state, seen, speed_squared(interval.steps))
    if state.reports and conditions.load_known:
        row = np.zeros(SIZE)
        for each, power in climate_powers(conditions.celsius, warmth).items():
            row[each] = power
        state = see_reported_climate(state, row, conditions.load, interval.duration)
    return condition(state, journey, interval.energy, interval.sampling_variance)
