"""One interval in numbers: from readings to coefficients, for `docs/explanation/one_interval.md`.

`python docs/generate.py` writes the page, and a test fails when it is not what the core gives.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math

from evpinn_ros.core.estimation.posterior import initial_state, interval_terms, learn
from evpinn_ros.core.estimation.states import PHYSICS, State
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.signals.reorder import in_order
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.core.vehicle.physics import RegenForm

HEAVIER = 1.15  # times the mass of the vehicle file: what the car of this page weighs
VOLTS = 360.0
SECONDS, HERTZ = 600, 10
SHOWN = (*PHYSICS[:3], State.P_AUX, State.FORCE_SQUARED, State.TURNING)

PAGE = """\
# One interval, in numbers

This page follows what the estimator does every ten seconds of driving, from readings to
coefficients. The example is a car that accelerates on a flat road: a BMW i3, but
{heavier:.0f} % heavier than its vehicle file says. Every number is computed by the functions named
here (`docs/one_interval.py`), so the page shows what the code does today.
[Architecture](architecture.md) explains how the parts work together.

## Readings in

There are ten readings (`core/signals/readings.py`) per second; the table shows one row every two
seconds. The current is negative when the battery is discharged.

| s | speed, m/s | voltage, V | current, A |
|---|---|---|---|
{readings}

## The interval

`IntervalBuilder` (`core/signals/interval.py`) cuts the interval into {count} steps and integrates.
No acceleration is needed, because the integral of v a is the difference of v^2 / 2.

| what | sum over the steps |
|---|---|
| duration | {interval.duration:.1f} s |
| distance | {interval.distance:.1f} m |
| integral of v^3, without wind | {air:.0f} m^3/s^2 |
| difference of v^2 / 2 | {kinetic:.1f} J/kg |
| **energy of the battery, the integral of -V I** | **{measured:.2f} kJ** |

## The row of the equation

`Equation.rows` (`core/estimation/terms.py`) computes the energy for one unit of each state.
Multiplied by the prior (`core/estimation/states.py`) and added up, this is the prediction, which
does not use the battery. Some of the states:

| state | J per unit | prior | product, kJ |
|---|---|---|---|
{row}
| all others | | | {others:.2f} |
| **together** | | | **{predicted:.2f}** |

## What the battery adds

`learn` (`core/estimation/posterior.py`) lets the time of the interval pass (`advance`) and
corrects the states by the difference between the measured and the predicted energy (`update`).
This difference is {residual:+.2f} kJ, with a 1-sigma of {sigma:.2f} kJ. Nearly all of this
uncertainty comes from the states; the noise contributes {noise:.2f} kJ. Each state changes by
{residual:+.2f} kJ times its covariance with the prediction, divided by the variance.

## Coefficients out

The table shows the mean over all hypotheses, with 1-sigma. One interval tells little about each
single state, but much about their sum. The whole drive of ten minutes has {driven} intervals and
begins to separate the states. The true m/eta of this car is {truth:.0f} kg.

| state | before | after this interval | after the whole drive |
|---|---|---|---|
{coefficients}
"""


def page() -> str:
    """The page, in Markdown."""
    vehicle = load_vehicle("bmw_i3")
    given = [*readings(vehicle)]
    driven = intervals(given, vehicle)
    interval = max(driven, key=lambda piece: float(piece.steps.kinetic.sum()))
    equation = Equation(vehicle)
    done = interval_terms(equation, interval, 0.0)
    row, before = done.journey.row, initial_state(equation)
    after, innovation = learn(before, equation, done)
    whole = before
    for piece in driven:
        whole, _ = learn(whole, equation, interval_terms(equation, piece, whole.seconds))
    products = {state: row[state] * equation.mean[state] for state in SHOWN}
    predicted = float(row @ equation.mean)
    mixtures = [state.mixture() for state in (before, after, whole)]
    return PAGE.format(
        heavier=100 * (HEAVIER - 1),
        readings="\n".join(_reading_rows(given, interval)),
        count=len(interval.steps.duration),
        interval=interval,
        air=interval.steps.air.sum(),
        kinetic=interval.steps.kinetic.sum(),
        measured=interval.energy / 1e3,
        row="\n".join(
            _line(_named(s), _digits(row[s]), _digits(equation.mean[s]), f"{joules / 1e3:.2f}")
            for s, joules in products.items()
        ),
        others=(predicted - sum(products.values())) / 1e3,
        predicted=predicted / 1e3,
        residual=innovation.residual / 1e3,
        sigma=innovation.sigma / 1e3,
        noise=math.sqrt(done.journey.noise.sum()) / 1e3,
        driven=len(driven),
        truth=HEAVIER * vehicle.initial.mass / vehicle.initial.eta,
        coefficients="\n".join(
            _line(
                _named(s),
                *(f"{_digits(m[s])} +- {_digits(math.sqrt(c[s, s]))}" for m, c in mixtures),
            )
            for s in SHOWN
        ),
    )


def readings(vehicle: Vehicle) -> Iterator[Reading]:
    """Speed, height and battery of the heavier car, in order of time."""
    car = vehicle.initial._replace(mass=HEAVIER * vehicle.initial.mass)
    for number in range(SECONDS * HERTZ):
        seconds, stamp_ns = number / HERTZ, NANOSECONDS + number * NANOSECONDS // HERTZ
        # Waves within a minute, on others within some.
        speed = 12.0 + 5.0 * math.sin(seconds / 10.0) + 4.0 * math.sin(seconds / 70.0)
        acceleration = 0.5 * math.cos(seconds / 10.0) + 4.0 / 70.0 * math.cos(seconds / 70.0)
        power = vehicle.power(speed, acceleration, car, RegenForm.WHEEL_POWER)
        yield SpeedReading(stamp_ns, speed)
        yield AltitudeReading(stamp_ns, 120.0)
        yield BatteryReading(stamp_ns, VOLTS, -float(power) / VOLTS)


def intervals(given: Iterable[Reading], vehicle: Vehicle) -> list[Interval]:
    """The intervals of a drive, as the estimator gets them."""
    stream = SampleStream(StreamSettings(), vehicle.air_density)
    return [interval for _, interval in stream.add(in_order(Block.of(given))).intervals]


def _reading_rows(given: Iterable[Reading], interval: Interval) -> Iterator[str]:
    speed = 0.0
    for reading in given:
        seconds = (reading.stamp_ns - interval.start_ns) / NANOSECONDS
        if not 0.0 <= seconds <= interval.duration or seconds % 2:
            continue
        if isinstance(reading, SpeedReading):
            speed = reading.speed
        elif isinstance(reading, BatteryReading):
            numbers = f"{speed:.2f}", f"{reading.voltage:.0f}", f"{reading.current:.1f}"
            yield _line(f"{seconds:.0f}", *numbers)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _named(state: State) -> str:
    return f"`{state.name}`, {state.unit}"


def _digits(value: float) -> str:
    """A number with three digits, none of them an exponent."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
