"""Rehearsals: simulated dropouts of the battery, and whole drives predicted at their start.

While the battery is measured, predictions are made without it: of the next 60 and 200 s, and of
each whole drive from the drives before it. Then they are compared with the energy drawn. A car's
state is a value, so a rehearsal needs no filter of its own: it keeps the state from which it began
and sums over the driving since.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.estimation.bands import Bands, PredictedEnergy
from evpinn_ros.core.estimation.journey import NOWHERE, Journey
from evpinn_ros.core.estimation.posterior import CarState, initial_state
from evpinn_ros.core.estimation.terms import Equation

LENGTHS = (60.0, 200.0)  # s of a rehearsed dropout; the longer ones scale the band
LEAST_SPEED = 2.5  # m/s, mean of a dropout that counts; a standing car shows nothing
LEAST_SPEED_SHARE = 0.25  # of the nominal speed, which is less for a robot
LEAST_DRIVE_METRES = 500.0  # of a whole drive that is compared


class Rehearsal(NamedTuple):
    """A simulated dropout: the car at its start, the driving since, and the energy drawn, J."""

    state: CarState
    journey: Journey = NOWHERE
    way: float = 0.0
    drawn: float = 0.0

    def predicted(self, equation: Equation) -> PredictedEnergy:
        """Its energy, predicted by the car at its start."""
        return self.state.model(equation).energy(self.journey)

    def plus(self, journey: Journey, way: float, drawn: float) -> Rehearsal:
        """The rehearsal with one more measured interval."""
        return Rehearsal(
            self.state, self.journey.plus(journey), self.way + way, self.drawn + drawn
        )


@dataclass(frozen=True, slots=True)
class Rehearsals:
    """The rehearsals under way: dropouts by their length, s, and the whole drive."""

    drive: Rehearsal
    dropouts: Mapping[float, Rehearsal] = field(default_factory=dict)

    def learn(
        self,
        state: CarState,
        equation: Equation,
        journey: Journey,
        planned: Journey,
        way: float,
        drawn: float,
    ) -> tuple[Rehearsals, Bands]:
        """Take a measured interval of `way` m and `drawn` J, with the car as it was before it.

        `planned` is the journey as a plan knows it, without the torque of the motor.
        """
        running, bands = {}, state.bands
        least_speed = np.fmin(LEAST_SPEED, LEAST_SPEED_SHARE * equation.vehicle.nominal_speed)
        for length in LENGTHS:
            rehearsal = self.dropouts.get(length, Rehearsal(state)).plus(journey, way, drawn)
            if rehearsal.journey.seconds < length:
                running[length] = rehearsal
            elif rehearsal.way >= least_speed * length:
                energy, long = rehearsal.predicted(equation), length == max(LENGTHS)
                bands = bands.after_dropout(energy, rehearsal.drawn, long=long)
        return Rehearsals(self.drive.plus(planned, way, drawn), running), bands

    def end_drive(self, state: CarState, equation: Equation) -> CarState:
        """The state whose bands have the error of the drive that ends here, predicted whole.

        The first drive counts for nothing, because nothing was learned before it.
        """
        before, journey, way, drawn = self.drive
        if before.intervals or not before.known or way < LEAST_DRIVE_METRES:
            return state
        learned, file = (
            car.model(equation).energy(journey) for car in (before, initial_state(equation))
        )
        return replace(state, bands=state.bands.after_drive(learned, file.mean, drawn))
