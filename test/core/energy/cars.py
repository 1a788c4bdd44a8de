"""Cars for tests: the physics of eq. 21 alone, and one that has learned from a drive."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
import math

from hypothesis import settings
import numpy as np

from benchmarks.truth import CarChain
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.meter import NO_STATES, EnergyState
from evpinn_ros.core.energy.power_model import PowerModel, combined_model
from evpinn_ros.core.estimation.states import PHYSICS, SIZE, State
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import Reading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.identifiable import Identifiable
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate


class LiveAccount(EnergyAccount):
    """An account that is given one value after the other, and counts each at once."""

    _held = False

    @contextmanager
    def together(self) -> Iterator[None]:
        """Count all values that come meanwhile at the end, as one block."""
        self._held = True
        yield
        self._held = False
        self.flush()

    def flush(self) -> EnergyState:
        return NO_STATES if self._held else super().flush()

    def add_measured(self, *row: float) -> None:
        super().add_measured(*map(np.atleast_1d, row))
        self.flush()

    def add_predicted(self, *row: float) -> None:
        rest = (math.nan,) * (5 - len(row))
        super().add_predicted(*map(np.atleast_1d, (*row, *rest)))
        self.flush()

    def add_speed(self, stamp_ns: int, speed: float) -> None:
        self.add_reading(SpeedReading(stamp_ns, speed))

    def add_reading(self, reading: Reading) -> None:
        self.add_block(Block.of([reading]))
        self.flush()


FEW = settings(max_examples=25, deadline=None)  # one more finds nothing
CAR = load_vehicle("tesla_model_3_lr")
COMBINED = Identifiable(2200.0, 0.65, 0.0096, 0.6, 1100.0)
EXACT = Identifiable(0.0, 0.0, 0.0, 0.0, 0.0)
SIGMAS = Identifiable(20.0, 0.05, 0.0005, 0.03, 100.0)
KEPT = [*PHYSICS, State.P_AUX]


def plain(combined: Identifiable = COMBINED, sigmas: Identifiable = EXACT) -> PowerModel:
    """A car of which eq. 21 is the whole truth: no other loss, load, noise or hill."""
    car = combined_model(combined, sigmas, CAR).car
    mean, covariance = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    mean[KEPT], square = car.mean[KEPT], np.ix_(KEPT, KEPT)
    covariance[square] = car.covariance[square]
    nothing = {"load_variance": 0.0, "growth": 0.0, "trust": 1.0, "noise": np.zeros(3)}
    return PowerModel(replace(car, mean=mean, covariance=covariance, **nothing))


@cache
def taught(seconds: float = 200.0) -> PowerModel:
    """A car as an estimator learned it from a drive in town."""
    chain = CarChain(CAR)
    chain.add_readings(simulate(DriveKind.URBAN, CAR, seconds, 4).readings)
    car = chain.car.begin_drive()
    return PowerModel(car.model())
