"""Change of payload between two drives: the difference of their `State.MASS_DRIVE`.

The load of a drive is a state of its own, so it is learned neither as mass of the car nor as
rolling resistance. Its value is as unsure as the mass of the car; its change is surer.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple, TypeAlias

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.posterior import CarState
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.signals.detector import ANOTHER_LOAD

Stamp: TypeAlias = Annotated[int, Range(0, 2**62)]  # ns; to the year 2116
Mass: TypeAlias = Annotated[float, Range(-1e6, 1e6)]  # kg


class Load(NamedTuple):
    """Load of a drive and its 1-sigma, kg."""

    mass: Mass
    std: Annotated[float, Range(0.0, 1e6)]


@dataclass(frozen=True, slots=True)
class PayloadChange:
    """Change of payload: stamp of the drive's begin, kg (positive: added), 1-sigma, kg."""

    stamp_ns: Stamp
    delta_mass: Mass
    std: Annotated[float, Range(0.0, 1e6)]


@dataclass(frozen=True, slots=True)
class Payload:
    """Load of this drive against that of the drive before.

    Attributes:
        before: load of the drive before; None in the first drive.
        begin_ns: stamp of this drive's begin, None before its first interval.
        change: of this drive, None while it is within chance.
    """

    before: Load | None = None
    begin_ns: Stamp | None = None
    change: PayloadChange | None = None

    def after(self, state: CarState, equation: Equation, begin_ns: int) -> Payload:
        """The payload after one more interval of this drive, which begins at a stamp."""
        begin_ns = begin_ns if self.begin_ns is None else self.begin_ns
        change = self.change
        if self.before is not None:
            now = load_of(state, equation)
            more, std = now.mass - self.before.mass, math.hypot(now.std, self.before.std)
            differs = ANOTHER_LOAD.judge(change is not None, abs(more) / std, state.seconds)
            change = PayloadChange(begin_ns, more, std) if differs else None
        return Payload(self.before, begin_ns, change)

    def next_drive(self, state: CarState, equation: Equation) -> Payload:
        """The payload at the begin of another drive."""
        return Payload(load_of(state, equation)) if state.intervals else Payload(self.before)


def load_of(state: CarState, equation: Equation) -> Load:
    """Load of this drive."""
    mean, covariance = state.mixture()
    eta = max(equation.eta + float(mean[State.ETA]), 0.1)
    variance = float(covariance[State.MASS_DRIVE, State.MASS_DRIVE])
    return Load(eta * float(mean[State.MASS_DRIVE]), eta * math.sqrt(max(variance, 1.0)))
