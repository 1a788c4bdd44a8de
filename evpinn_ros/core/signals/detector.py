"""Detectors of faults: one hysteresis, and one table of them all.

A detector is a value: `after` gives the detector after one more observation, `detected` names
the fault that it sees now, or is None. It follows one number, its evidence, and a row of the table
gives the verdict: a fault above `on`, none at or below `off`; in between, and while the evidence
rests on less than `least`, the verdict stays. `docs/reference/detectors.md` is made from it.

Checks of single values are no detectors, because they have no memory: ranges (`readings`), leaps
of speed (`kinematics.SpeedTrack.leaps`) and of altitude (`height`). Nor are jumps of time
(`time_jump`), which hold readings back and put them in order, and the fit of a CAN profile
(`can.fit`), which counts frames.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Hysteresis(NamedTuple):
    """A row of the table.

    Attributes:
        fault: name.
        evidence: quantity that is followed.
        unit: of the evidence.
        on: evidence above which there is the fault.
        off: evidence at or below which there is none.
        least: data that the evidence must rest on for a verdict, in the unit of `rests_on`.
        rests_on: unit and kind of these data.
        effect: consequence while the fault is detected.
    """

    fault: str
    evidence: str
    unit: str
    on: float
    off: float
    least: float
    rests_on: str
    effect: str

    def judge(self, before: bool | None, evidence: float, amount: float = math.inf) -> bool | None:
        """The verdict after the one before; None while there is none.

        Args:
            before: the verdict so far.
            evidence: now; NaN where there is none.
            amount: data that it rests on, in the unit of `rests_on`.
        """
        if amount < self.least:
            return before
        if evidence > self.on:
            return True
        return False if evidence <= self.off else before


CURRENT_SIGN, GRADE_SIGN = "current_sign", "grade_sign"
SPEED_STUCK, BATTERY_STUCK, SPEED_REPEATS = "speed_stuck", "battery_stuck", "speed_repeats"
ALTITUDE_STUCK, PAYLOAD, PARAMETER = "altitude_stuck", "payload", "invalid"
NEVER = -math.inf  # as `off`: the verdict stays until another value begins a new repetition
OF_BUS = "`evpinn can inspect` and diagnostics report it"
NOT_LEARNED = "nothing is learned from the repetition"

AGAINST_INERTIA = Hysteresis(
    CURRENT_SIGN, "share of power that is against acceleration, in about a minute", "1",
    0.5, 0.0, 10.0, "s of pulling away and braking", "nothing is learned, no parameter is valid",
)  # fmt: skip
AGAINST_CHARGE = Hysteresis(
    CURRENT_SIGN, "1 where charge rises as energy is drawn, else -1; by steps of 2 %", "1",
    0.0, 0.0, 1e6, "J; less may be bookkeeping of the car", OF_BUS,
)  # fmt: skip
DRAWN_AT_REST = Hysteresis(
    CURRENT_SIGN, "mean power drawn at rest, in about 30 s", "W", 20e3, -20e3, 0.0, "", OF_BUS
)
AGAINST_HILLS = Hysteresis(
    GRADE_SIGN, "how clearly reported climb and energy contradict, in about 20 km", "sigma",
    3.0, 0.0, 2e3, "m of road", "diagnostics report it",
)  # fmt: skip
FINE_SPEED = Hysteresis(
    SPEED_STUCK, "change of power while a speed with steps below 0.1 m/s repeats", "W",
    30e3, NEVER, 2.0, "s of repetition", NOT_LEARNED,
)  # fmt: skip
# A speed in whole km/h or mph repeats by itself: for 3.9 s and 66 kW in 13 real drives so rounded.
COARSE_SPEED = FINE_SPEED._replace(
    evidence="change of power while a coarser speed repeats", on=60e3, least=5.0
)
FINE_DOUBT = FINE_SPEED._replace(fault=SPEED_REPEATS, on=20e3, off=20e3, least=1.0)
COARSE_DOUBT = COARSE_SPEED._replace(
    evidence="change of power while a coarser speed repeats, ten times or more",
    fault=SPEED_REPEATS, on=20e3, off=20e3, least=2.0,
)  # fmt: skip
BATTERY_REPEATS = Hysteresis(
    BATTERY_STUCK,
    "change of speed while voltage and current repeat, or 0 A; below 5 kW its rise alone",
    "m/s", 5.0, NEVER, 2.0, "s of repetition", f"the battery is not used, {NOT_LEARNED}",
)  # fmt: skip
ONE_ALTITUDE = Hysteresis(  # on a flat road too, the last digit of altitude changes
    ALTITUDE_STUCK, "road since the altitude changed", "m", 1e3, 0.0, 0.0, "", "height is unknown"
)
ANOTHER_LOAD = Hysteresis(
    PAYLOAD, "payload change since the drive before", "sigma",
    3.0, 2.0, 300.0, "s of the drive", "diagnostics report it",
)  # fmt: skip
FAR_FROM_PRIOR = Hysteresis(
    PARAMETER, "distance of a parameter from the vehicle file", "prior sigma",
    6.0, 5.0, 0.0, "", "the parameter is invalid",
)  # fmt: skip

TABLE = (
    AGAINST_INERTIA, AGAINST_CHARGE, DRAWN_AT_REST, AGAINST_HILLS, FINE_SPEED, COARSE_SPEED,
    FINE_DOUBT, COARSE_DOUBT, BATTERY_REPEATS, ONE_ALTITUDE, ANOTHER_LOAD, FAR_FROM_PRIOR,
)  # fmt: skip
