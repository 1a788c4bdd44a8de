"""The table of states of a car, of a drive and of the last minutes.

Slices, priors, keys of a saved car and `docs/reference/states.md` are made from this table.
A new state is one line here and one column in `estimation.terms`; a saved car that lacks it begins
at its prior.

Behind the states of the table stand the output weights of the network (`estimation.network`).
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, IntEnum

import numpy as np

from evpinn_ros.core.vehicle.files import Vehicle

NETWORK = 40  # weights, all of the car


class Duration(str, Enum):
    """Time that a state holds for."""

    CAR = "car"  # lasts, and drifts a little from drive to drive
    DRIVE = "drive"  # begins anew with a drive, which keeps a part of the last value
    FAST = "fast"  # decays within minutes


CAR, DRIVE, FAST = Duration


class State(IntEnum):
    """Index of a state, with its unit, level, prior and the source of that.

    A prior of None is made from the vehicle file (`prior_of`).
    """

    unit: str
    level: Duration
    mean: float | None
    std: float | None
    source: str

    def __new__(
        cls, unit: str, level: Duration, mean: float | None, std: float | None, source: str
    ) -> State:
        """Number the states in the order in which they stand here."""
        state = int.__new__(cls, len(cls.__members__))
        state._value_ = len(cls.__members__)
        state.unit, state.level, state.source = unit, level, source
        state.mean, state.std = mean, std
        return state

    DRAG_AREA_OVER_ETA = "m^2", CAR, None, None, "A C_d / eta of the vehicle file"
    ROLLING = "kg", CAR, None, None, "C_rr m / eta of the vehicle file"
    MASS_OVER_ETA = "kg", CAR, None, None, "m / eta of the vehicle file"
    REGEN_DELTA = "1", CAR, None, None, "eta mu less that of the vehicle file"
    ETA = "1", CAR, None, None, "eta less that of the vehicle file; motor torque alone shows it"
    P_AUX = "W", CAR, None, None, "p_aux of the vehicle file: standing load on a mild day"
    MOTOR_DRIVE = "1", CAR, None, None, "energy of the battery over that of the motor, driving"
    MOTOR_BRAKE = "1", CAR, 0.9, 0.06, "the same while braking; an inverter and a pack lose 10 %"
    MOTOR_RATIO = "1", CAR, 0.0, 0.3, "motor energy over the reported, where its ratio is unknown"
    FORCE_SQUARED = (
        "W/(m/s^2)^2", CAR, 200.0, 200.0,
        "windings lose 1 to 3 kW of the 60 kW of a full launch at 3 m/s^2",
    )  # fmt: skip
    TURNING = "W", CAR, 150.0, 100.0, "a drivetrain that turns idly takes 50 to 300 W in town"
    ROLLING_COLD = "1/(10 K)", CAR, 0.06, 0.05, "0.6 % per K; ISO 28580 corrects by 0.8 %"
    ROLLING_START = "1", CAR, 0.15, 0.10, "tyres warm up within half an hour (Ejsmont 2018)"
    COLD = "W/K", CAR, 60.0, 60.0, "heating of a small car (Lohse-Busch, SAE 2013-01-1462)"
    HOT = "W/K", CAR, 30.0, 40.0, "half of that, with a coefficient of performance of 2"
    COLD_START = "W/K", CAR, 60.0, 50.0, "twice as much until the cabin is warm"
    HOT_START = "W/K", CAR, 30.0, 40.0, "the same for cooling"
    REPORTED = "1", CAR, 1.0, 0.15, "share of a reported load that the battery gives"
    ROLLING_DRIVE = "1", DRIVE, 0.0, 0.08, "wind, rain and tyres of one drive"
    MASS_DRIVE = "kg", DRIVE, 0.0, 80.0, "over eta: people and luggage of one drive"
    LOSS_DRIVE = "1", DRIVE, 0.0, 0.02, "share of energy in and out that no other state explains"
    LOAD_DRIVE = "W", DRIVE, 0.0, 250.0, "what is switched on in one drive"
    LOAD = "W", FAST, 0.0, 0.0, "wandering load; its size is a hypothesis"
    LOAD_ENERGY = "J", FAST, 0.0, 0.0, "energy of the wandering load in the present interval"
    WANDERED = "J", DRIVE, 0.0, 0.0, "energy of the wandering load in this drive before it"
    CLIMB = "J", FAST, 0.0, 0.0, "potential energy of unseen height, of the present interval"
    CLIMBED = "J", DRIVE, 0.0, 0.0, "the same of this drive before it"


TABLE = len(State)
SIZE = TABLE + NETWORK
WEIGHTS = slice(TABLE, SIZE)
LASTING = [*(s for s in State if s.level is CAR), *range(TABLE, SIZE)]  # states of the car
OFFSETS = [State.ROLLING_DRIVE, State.MASS_DRIVE, State.LOAD_DRIVE]  # learned in a drive
PHYSICS = [*State][:4]  # the terms of eq. 21
NAMES = (*(state.name.lower() for state in State), *(f"network_{i}" for i in range(NETWORK)))
SAVED_BEFORE = {  # names of states in files up to 0.3.0
    "drag": "drag_area_over_eta", "mass": "mass_over_eta", "back": "regen_delta",
}  # fmt: skip
GEARS = 0.97, 0.03  # share of the motor's energy that reaches the wheels, with its 1-sigma


def known_names(names: Sequence[str]) -> tuple[list[int], list[int]]:
    """Indices of those names that are states of this table: in `names`, and in the table."""
    names = [SAVED_BEFORE.get(name, name) for name in names]
    there = [place for place, name in enumerate(names) if name in NAMES]
    return there, [NAMES.index(names[place]) for place in there]


def prior_of(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Mean, shape (SIZE,), and covariance, shape (SIZE, SIZE), before any drive.

    What the vehicle file has of eta, mu, mass, c_rr and c_d (with their correlations) is carried
    to first order to their combinations. Weights of the network and the fast states are zero
    here: their sizes are hypotheses (`estimation.posterior`).
    """
    eta, mu, mass, c_rr, c_d, p_aux = (prior.value for prior in vehicle.priors.values())
    share = np.array([prior.std / max(prior.value, 1e-9) for prior in vehicle.priors.values()])
    share[5] = 1.0  # p_aux is not a logarithm, and may be zero
    motor = GEARS[0] / eta
    values = {
        State.DRAG_AREA_OVER_ETA: vehicle.frontal_area * c_d / eta,
        State.ROLLING: c_rr * mass / eta,
        State.MASS_OVER_ETA: mass / eta,
        State.REGEN_DELTA: eta * mu,
        State.ETA: eta,
        State.P_AUX: vehicle.priors["p_aux"].std,
        State.MOTOR_DRIVE: motor,
    }
    #                 eta, mu, mass, c_rr, c_d, p_aux: by which power each enters
    powers = np.array([
        [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        [-1.0, 0.0, 1.0, 1.0, 0.0, 0.0],
        [-1.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        [1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ])  # fmt: skip
    scale = powers * share * np.array(list(values.values()))[:, None]
    mean, covariance = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    for state in State:
        mean[state], covariance[state, state] = state.mean or 0.0, (state.std or 0.0) ** 2
    index = list(values)
    covariance[np.ix_(index, index)] = scale @ vehicle.correlation @ scale.T
    covariance[State.MOTOR_DRIVE, State.MOTOR_DRIVE] += (motor * GEARS[1] / GEARS[0]) ** 2
    mean[index] = [*values.values()]
    mean[[State.REGEN_DELTA, State.ETA]] = 0.0
    mean[State.P_AUX] = p_aux
    return mean, covariance
