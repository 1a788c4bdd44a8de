"""A safety net of forecasts: the learned car against its vehicle file and energy per km.

Each whole drive is predicted at its start by three experts: the learned car, the vehicle file
alone, and the energy per kilometre of the drives before. Their log scores are the evidence of a
mixture; the spread of a simple expert is that of its own errors. Where the odds are beyond
`LEAST_ODDS` for a simple expert, forecasts of plans rest on it, until later drives say otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
import math
from typing import Annotated, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.bands import CASES_KEPT, MOST_DEVIATE, Spread
from evpinn_ros.core.estimation.calibration import MOST_SUM
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import BESIDE, CLIMATE, STANDING_LOADS, TYRES

PRIOR_ODDS = np.log([0.15 / 0.7, 0.15 / 0.7])  # of the simple experts over the learned car
LEAST_ODDS, LEAST_DRIVES = math.log(100.0), 3
PER_KM_SHARE = 0.25  # 1-sigma of the energy per km of a drive over the mean, before any
KEPT = 1.0 - 1.0 / CASES_KEPT  # of all sums, from drive to drive
MOST_ODDS, MOST_DRIVES = 1e6, 1e9
LEAST_SIGMA = 1.0  # J
PARTS = {
    "air": [State.DRAG],
    "tyres": [State.ROLLING, *TYRES],
    "mass": [State.MASS],
    "braking": [State.BACK, State.MOTOR_BRAKE],
    "motor and drivetrain": [State.MOTOR_DRIVE, State.MOTOR_RATIO, *BESIDE],
    "heating and cooling": CLIMATE,
    "other standing load": STANDING_LOADS,
}
"""States of what the learned car may have got wrong."""
ENERGIES = "energy", "measured", "error", "size", "beyond"  # fields of `Experts`, J


class Expert(IntEnum):
    """What a whole drive is predicted by; the simple ones stand behind the learned car."""

    LEARNED = 0
    FILE = 1
    PER_KM = 2

    @property
    def words(self) -> str:
        """What forecasts rest on."""
        return ("learned car", "vehicle file alone", "energy per km of earlier drives")[self]

    @property
    def verdict(self) -> str:
        """Status of forecasts that rest on it in place of the learned car."""
        return f"the {self.words} predicts this car better"


class WholeDrive(NamedTuple):
    """A drive that ended, as two experts predicted it at its start.

    Attributes:
        way: m.
        drawn: J.
        learned: energy and 1-sigma by the learned car, J; None of the first drive.
        file: the same by the vehicle file, its spread not counted.
        beyond: energy of the learned car less that of the file by state, J, shape (SIZE,).
    """

    way: float
    drawn: float
    learned: tuple[float, float] | None
    file: tuple[float, float]
    beyond: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Experts:
    """Scores of the experts by the drives so far; a value.

    Attributes:
        drives: scored.
        odds: logarithm of the odds of each simple expert by these, shape (2,).
        cases: drives that their spreads rest on.
        squares: sums of their squared errors in sigmas.
        energy: of all drives, J.
        metres: of all drives.
        measured: energy of the drives that were scored, J.
        error: of the learned car in these, J.
        size: of these errors without their signs, J.
        beyond: energy of the learned car beyond that of the file, by `PARTS`, J.
    """

    drives: Annotated[float, Range(0.0, MOST_DRIVES)]
    odds: Annotated[np.ndarray, Range(-MOST_ODDS, MOST_ODDS, shape=(2,))]
    cases: Annotated[np.ndarray, Range(0.0, CASES_KEPT, shape=(2,))]
    squares: Annotated[np.ndarray, Range(0.0, MOST_SUM, shape=(2,))]
    energy: Annotated[float, Range(-MOST_SUM, MOST_SUM)]
    metres: Annotated[float, Range(0.0, MOST_SUM)]
    measured: Annotated[float, Range(-MOST_SUM, MOST_SUM)]
    error: Annotated[float, Range(-MOST_SUM, MOST_SUM)]
    size: Annotated[float, Range(0.0, MOST_SUM)]
    beyond: Annotated[np.ndarray, Range(-MOST_SUM, MOST_SUM, shape=(len(PARTS),))]

    @classmethod
    def none(cls) -> Experts:
        """Before any drive."""
        odds, cases, squares = np.zeros((3, 2))
        return cls(0.0, odds, cases, squares, 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(len(PARTS)))

    @property
    def best(self) -> Expert:
        """The expert that forecasts rest on."""
        odds = PRIOR_ODDS + self.odds
        if self.drives < LEAST_DRIVES or odds.max() <= LEAST_ODDS:
            return Expert.LEARNED
        return Expert(1 + int(odds.argmax()))

    @property
    def cost(self) -> float:
        """Energy over distance, J/m."""
        return self.energy / max(self.metres, 1.0)

    def spread(self, expert: Expert) -> Spread:
        """Errors of a simple expert, in sigmas."""
        return Spread(float(self.cases[expert - 1]), float(self.squares[expert - 1]))

    @property
    def sentence(self) -> str | None:
        """Sentence on what forecasts rest on and what the learned car got wrong, or None."""
        if self.best is Expert.LEARNED:
            return None
        text, sign = self.best.verdict, math.copysign(1.0, self.error)
        if self.measured > 0.0:
            erred, net = 100.0 * self.size / self.measured, 100.0 * self.error / self.measured
            drives = min(self.drives, CASES_KEPT)
            text += f": over {drives:.0f} drives the learned car erred by {erred:.0f} % of the "
            text += f"energy ({net:+.0f} % in sum)"
        part = int((sign * self.beyond).argmax())
        if sign * self.beyond[part] > 0.0:
            text += f", most by what it learned of {[*PARTS][part]}"
        return f"{text[0].upper()}{text[1:]}. Forecasts rest on it."

    def after(self, drive: WholeDrive) -> Experts:
        """With one more drive; the first teaches what a km takes, and how the file errs."""
        simple, learned = [drive.file], drive.learned if self.metres else None
        if self.metres:
            energy = self.cost * drive.way
            simple.append((energy, PER_KM_SHARE * abs(energy)))
        odds, cases, squares = (array.copy() for array in (self.odds, self.cases, self.squares))
        for place, (energy, sigma) in enumerate(simple):
            error, spread = drive.drawn - energy, Spread(cases[place], squares[place])
            if learned is not None:
                gain = log_score(error, math.sqrt(spread.scale) * sigma)
                gain -= log_score(drive.drawn - learned[0], learned[1])
                odds[place] = KEPT * odds[place] + gain
            cases[place], squares[place] = spread.after(error / max(sigma, LEAST_SIGMA))
        sums, beyond = {"energy": drive.drawn, "metres": drive.way}, self.beyond
        if learned is not None:
            error = learned[0] - drive.drawn
            sums |= {"measured": drive.drawn, "error": error, "size": abs(error)}
            beyond = KEPT * beyond + [drive.beyond[states].sum() for states in PARTS.values()]
        return replace(
            self,
            drives=min(self.drives + (learned is not None), MOST_DRIVES),
            odds=np.clip(odds, -MOST_ODDS, MOST_ODDS),
            cases=cases,
            squares=squares,
            beyond=beyond,
            **{name: KEPT * getattr(self, name) + more for name, more in sums.items()},
        )


def log_score(error: float, sigma: float) -> float:
    """Logarithm of a predicted density at an error, both J.

    Beyond `MOST_DEVIATE` it falls with the square of the error alone: one odd drive decides
    nothing, and nothing is gained there by a smaller sigma.
    """
    sigma = max(sigma, LEAST_SIGMA)
    away = abs(error) / sigma
    beyond = max(away / MOST_DEVIATE, 1.0)
    return -0.5 * min(away, MOST_DEVIATE) ** 2 - 2.0 * math.log(beyond) - math.log(sigma)
