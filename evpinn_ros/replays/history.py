"""Collects the time series of a replayed drive, for scores and charts."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.energy.account import AccountSummary
from evpinn_ros.core.energy.meter import EnergyState
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import TRACKED, ParameterSet, PowerEstimate, PowerKind
from evpinn_ros.core.estimation.learner import LearnerReport
from evpinn_ros.core.estimation.outputs import Outputs
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import (
    DAY_NS,
    DRIVE_START_NS,
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    Reading,
    SpeedReading,
    TemperatureReading,
    drawn_power,
    has_position,
)
from evpinn_ros.core.signals.time_jump import Jump
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.logs.signal import leaps
from evpinn_ros.replays.chain import ChainOutput

BEYOND = 8.0  # sigmas of the open-circuit voltage from its median
FOLLOWS = 0.5  # largest share of changes of voltage that current does not explain
# If voltage and current are not simultaneous, as from many dongles, many readings look like
# outliers: unless this share is within so many sigmas, none counts as one.
MOST, NEAR = 0.9, 2.5
FEW = 30  # readings; so few are not checked
BESIDE = 7  # readings of the running median
AT_ONCE = 10_000  # medians computed together


def lone_battery(voltage: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Mask of lone outliers among voltages, V, and currents, A, in order of time; shape (n,)."""
    none = np.zeros(len(voltage), dtype=bool)
    volts, amperes = np.diff(voltage), np.diff(current)
    large = np.abs(amperes) > np.median(np.abs(amperes)) if len(voltage) > FEW else none
    if not large.any():
        return none
    resistance = float(np.median(volts[large] / amperes[large]))
    left = (volts - resistance * amperes)[large]
    if resistance <= 0.0 or _sigma(left) > FOLLOWS * _sigma(volts[large]):
        return none
    open_circuit = voltage - resistance * current
    around = np.pad(open_circuit, BESIDE // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(around, BESIDE)
    parts = range(0, len(windows), AT_ONCE)  # each part is copied
    median = np.concatenate([np.median(windows[i : i + AT_ONCE], axis=1) for i in parts])
    away = np.abs(open_circuit - median)
    sigma = _sigma(away)
    return np.asarray((away > BEYOND * sigma) & (np.quantile(away, MOST) < NEAR * sigma))


def lone_speeds(time: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Mask of speeds, m/s, that jump away and back; shape (n,) each, in order of `time`, s."""
    leapt, change = leaps(time, speed), np.diff(speed)
    lone = np.zeros(len(time), dtype=bool)
    lone[1:-1] = leapt[1:] & leapt[:-1] & (change[1:] * change[:-1] < 0.0)
    return lone


def _sigma(values: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(values)))


FIRST_STAMP_NS = 631_152_000 * NANOSECONDS  # 1990: stamps of an earlier log count from its start
JUMP_GAP = 60 * NANOSECONDS  # added at a jump of time, so that nothing is joined across it
MODEL_STEP = 300.0  # s between two kept models, for forecasts at that time
SERIES = dict.fromkeys(("speed", "altitude", "charge", "temperature", "heating", "jumps"), 2)
SERIES |= {"position": 3, "energy": 4}
"""Series of a `Drive` that need no conversion, and their columns."""


class Columns:
    """A growing table of numbers in compact memory: an hour at 10 Hz is a few MB."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._numbers = array("d")

    def add(self, *row: float) -> None:
        """Append one row."""
        self._numbers.extend(row)

    def extend(self, *columns: np.ndarray) -> None:
        """Append rows, given as columns of the same length."""
        self._numbers.frombytes(np.stack(columns, axis=1).astype(float).tobytes())

    def values(self) -> np.ndarray:
        """All rows, shape (n, width), not copied: add no rows while the array is in use."""
        return np.asarray(self._numbers).reshape(-1, self._width)


class PowerSeries(NamedTuple):
    """Predictions: time since the start, s, power and 1-sigma, W, and lag, s, shape (n,) each."""

    time: np.ndarray
    power: np.ndarray
    sigma: np.ndarray
    lag: np.ndarray


class Detection(NamedTuple):
    """Detections of the learner, valid from a time on."""

    time: float  # s since the first reading
    report: LearnerReport


class KnownModel(NamedTuple):
    """The model of the car as known at a time."""

    time: float  # s since the first reading
    model: CarModel


@dataclass(frozen=True, slots=True)
class Drive:
    """The series of one replayed drive; times in s since its first reading, plus `JUMP_GAP`s."""

    duration: float  # s
    speed: np.ndarray  # time and m/s, shape (n, 2)
    measured: np.ndarray  # time and W of every battery sample, also withheld ones, shape (n, 2)
    smoothed: PowerSeries  # predictions of `power/smoothed`
    newest: PowerSeries  # predictions of `power/predicted`
    # time, predicted and RKNN energy, J, and 1-sigma of the predicted, shape (n, 4); other methods
    # give no 1-sigma
    energy: np.ndarray
    parameters: Mapping[str, np.ndarray]  # by name: time, value, 1-sigma, prior share, (n, 4)
    final: ParameterSet | None  # the last parameters, None if there were none
    start_ns: int = 0  # stamp of the first reading
    zoned: bool = True  # True if its times are UTC, False if local
    reading_notes: tuple[str, ...] = ()  # assumptions made in reading the log
    doubts: tuple[str, ...] = ()  # why its totals are not certain
    stops_s: float = 0.0  # s of stops between short drives of one trip
    altitude: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))  # time and m
    # time, latitude and longitude, degrees, shape (n, 3)
    position: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    # time and state of charge, 0..1, shape (n, 2)
    charge: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    # time and temperature of the outside air, degrees Celsius, shape (n, 2)
    temperature: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    # time and power of heating reported by the car, W, shape (n, 2)
    heating: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    # of each identifiable combination: time, value, 1-sigma, shape (n, 3)
    combinations: Mapping[str, np.ndarray] = field(default_factory=dict)
    detections: tuple[Detection, ...] = ()  # of the learner, at each change
    models: tuple[KnownModel, ...] = ()  # the car as known about every `MODEL_STEP`
    model: CarModel | None = None  # the car as known at the end, or None
    # time of each jump, and its size, s, shape (n, 2)
    jumps: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    # kWh and 1-sigma by part, as last published; empty without `add_breakdown`
    breakdown: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # mask of the lone outliers in `measured`, shape (n,); or empty
    lone: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=bool))

    @property
    def driven_s(self) -> float:
        """Duration without the stops between short drives, s."""
        return self.duration - self.stops_s

    @property
    def dated(self) -> bool:
        """Whether the date of the log is known."""
        without_day = 0 <= self.start_ns - DRIVE_START_NS < DAY_NS
        return self.start_ns >= FIRST_STAMP_NS and not without_day


class History:
    """Collects a `Drive` while it is replayed."""

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._newest_ns = self._offset_ns = 0
        self._jumped: Jump | None = None
        self._series = {name: Columns(width) for name, width in SERIES.items()}
        self._voltage, self._current = Columns(2), Columns(2)
        self._combinations = {name: Columns(3) for name in IDENTIFIABLE_NAMES}
        self._detections: list[Detection] = []
        self._models: list[KnownModel] = []
        self._power = {PowerKind.SMOOTHED: Columns(4), PowerKind.PREDICTED: Columns(4)}
        self._parameters = {name: Columns(1 + len(TRACKED)) for name in PARAMETER_NAMES}
        self._final: ParameterSet | None = None
        self._breakdown: Mapping[str, tuple[float, float]] = {}

    def seconds(self, stamps: Any) -> Any:
        """Time of stamps since the first reading, s."""
        moments = self.moment(stamps)
        return (moments - (moments if self._start_ns is None else self._start_ns)) / NANOSECONDS

    def moment(self, stamps: Any) -> Any:
        """Stamps after the last jump of time, moved to the common axis of all series; ns."""
        return stamps + self._offset_ns

    def add_jump(self, jump: Jump) -> None:
        """Take a jump of time back before the next reading."""
        self._jumped = jump

    def add_reading(self, reading: Reading) -> None:
        """Take one admitted reading."""
        self.add_block(Block.of([reading]))

    def add_block(self, block: Block) -> None:
        """Append admitted readings to their series; after a jump of time, `JUMP_GAP` later."""
        stamps = block.stamps()
        if self._start_ns is None:
            self._start_ns = self._newest_ns = int(stamps[0])
        if self._jumped is not None:
            self._offset_ns = self._newest_ns + JUMP_GAP - int(stamps[0])
            self._series["jumps"].add(self.seconds(int(stamps[0])), self._jumped.seconds)
            self._jumped = None
        self._newest_ns = max(self._newest_ns, int(self.moment(stamps).max()))
        self._add_columns(block)

    def _add_columns(self, block: Block) -> None:
        series = self._series
        for kind, (_, stamps, values) in block.rows.items():
            time, first = self.seconds(stamps), values[0]
            if kind is SpeedReading:
                series["speed"].extend(time, first)
            elif kind is BatteryReading:
                charge = values[2]
                has_charge = (charge >= 0.0) & (charge <= 1.0)
                columns = (self._voltage, first), (self._current, values[1])
                for column, numbers in columns:
                    column.extend(time[np.isfinite(numbers)], numbers[np.isfinite(numbers)])
                series["charge"].extend(time[has_charge], charge[has_charge])
            elif kind is AltitudeReading:
                series["altitude"].extend(time, first)
                has_place = has_position(*values[1:])
                series["position"].extend(time[has_place], *values[1:, has_place])
            elif kind is TemperatureReading:
                series["temperature"].extend(time, first)
            elif kind is AuxiliaryReading:
                series["heating"].extend(time, first)

    def add_outputs(self, outputs: Outputs) -> None:
        """Take the estimator's outputs for a block."""
        for kind, (known_ns, stamps, power, sigma, *_) in outputs.powers():
            if kind in self._power:
                lag = (known_ns - stamps) / NANOSECONDS
                self._power[kind].extend(self.seconds(stamps), power, sigma, lag)
        for learned in outputs.learned:
            self.add_output(learned.known_ns, learned.parameters)
            self.add_detections(learned.known_ns, learned.report)
            if self.wants_model(learned.known_ns):
                self.add_model(learned.known_ns, learned.model)

    def add_output(self, known_ns: int, output: ChainOutput) -> None:
        """Take an output of the chain, completed by the reading with stamp `known_ns`."""
        if isinstance(output, (AccountSummary, Breakdown)):
            return
        time = self.seconds(output.stamp_ns)
        if isinstance(output, EnergyState):
            predicted, rknn = output.predicted.energy, output.rknn.energy
            if math.isfinite(predicted) and math.isfinite(rknn):  # not before the first step
                self._series["energy"].add(time, predicted, rknn, output.predicted.sigma)
        elif isinstance(output, PowerEstimate):
            if output.kind in self._power:
                lag = (known_ns - output.stamp_ns) / NANOSECONDS
                self._power[output.kind].add(time, output.power, output.sigma, lag)
        else:
            self._final = output
            for name, estimate in output.parameters.items():
                row = (time, *(getattr(estimate, figure) for figure in TRACKED))
                self._parameters[name].add(*row)
            for name, rows in self._combinations.items():
                value, std = (
                    getattr(combinations, name)
                    for combinations in (output.identifiable, output.identifiable_std)
                )
                rows.add(time, value, std)

    def add_states(self, states: EnergyState) -> None:
        """Take states of the account, one for each prediction."""
        self._series["energy"].extend(
            self.seconds(states.stamp_ns),
            states.predicted.energy,
            states.rknn.energy,
            states.predicted.sigma,
        )

    def add_detections(self, known_ns: int, report: LearnerReport) -> None:
        """Take the learner's detections at a stamp, if they changed."""
        if not self._detections or self._detections[-1].report[:4] != report[:4]:
            self._detections.append(Detection(self.seconds(known_ns), report))

    def add_breakdown(self, breakdown: Mapping[str, tuple[float, float]]) -> None:
        """Take the present breakdown, kWh and 1-sigma by part."""
        self._breakdown = breakdown

    def wants_model(self, known_ns: int) -> bool:
        """Whether `MODEL_STEP` has passed since the last model."""
        seconds = self.seconds(known_ns)
        return not self._models or seconds - self._models[-1].time >= MODEL_STEP

    def add_model(self, known_ns: int, model: CarModel | None) -> None:
        """Take the car model known at a stamp; None from a learner without one."""
        if model is not None:
            self._models.append(KnownModel(self.seconds(known_ns), model))

    @property
    def now(self) -> float:
        """Time of the newest reading, s since the first one."""
        return 0.0 if self._start_ns is None else (self._newest_ns - self._start_ns) / NANOSECONDS

    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        """Power at each current reading with interpolated voltage, W; and mask of lone ones."""
        voltage, current = (_in_order(c.values()) for c in (self._voltage, self._current))
        if not (len(voltage) and len(current)):
            return np.empty((0, 2)), np.empty(0, dtype=bool)
        time, amperes = current.T
        volts = np.interp(time, *voltage.T)
        measured = np.column_stack((time, drawn_power(volts, amperes)))
        return measured, lone_battery(volts, amperes)

    def drive(self, model: CarModel | None = None) -> Drive:
        """The series so far, with the present model of the car."""
        plain: dict[str, Any] = {name: rows.values() for name, rows in self._series.items()}
        measured, lone = self._measured()
        return Drive(
            **plain,
            duration=self.now,
            measured=measured,
            lone=lone,
            smoothed=PowerSeries(*self._power[PowerKind.SMOOTHED].values().T),
            newest=PowerSeries(*self._power[PowerKind.PREDICTED].values().T),
            parameters={name: rows.values() for name, rows in self._parameters.items()},
            final=self._final,
            start_ns=self._start_ns or 0,
            combinations={name: rows.values() for name, rows in self._combinations.items()},
            detections=tuple(self._detections),
            models=tuple(self._models),
            model=model,
            breakdown=self._breakdown,
        )


def _in_order(rows: np.ndarray) -> np.ndarray:
    if (np.diff(rows[:, 0]) > 0.0).all():
        return rows
    _, first = np.unique(rows[:, 0], return_index=True)
    return rows[first]
