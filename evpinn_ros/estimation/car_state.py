"""States learned of a car and of a drive, their priors and how long each holds.

Two levels. What belongs to the *car* lasts. What belongs to the *drive* (wind, tyres, an
auxiliary load) has a variance of its own, learned from drive to drive, and fades over the drives
that follow. *Fast* states change within minutes or hundreds of metres.

eta, mu, mass and C_d are logarithms, so products that data determine are sums and the direction
that they do not (all scaled together) is one straight line on which the prior stays. C_rr is
linear, as a share of its prior: it competes with slopes and offsets that are linear too.
"""

from __future__ import annotations

from enum import IntEnum
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.vehicle.files import Vehicle


class State(IntEnum):
    """Index of a state. The first six are `vehicle.parameters.PARAMETER_NAMES`, in their order."""

    ETA = 0  # logarithm
    MU = 1  # logarithm
    MASS = 2  # logarithm, kg
    C_RR = 3  # over its prior
    C_D = 4  # logarithm
    P_AUX = 5  # W, standing load on a mild day
    NO_LOAD = 6  # W that the drivetrain loses by turning, at `linear_power.TURNING_SPEED`
    COPPER = 7  # W / (m/s^2)^2, loss by force squared over mass squared
    ROLL_COLD = 8  # share of rolling resistance more per 10 K of cold
    ROLL_START = 9  # share of it more while tyres are cold
    COLD, HOT = 10, 11  # W/K of heating and cooling that the car does not report
    COLD_START, HOT_START = 12, 13  # W/K more of it until the cabin has its temperature
    REPORTED = 14  # share of the reported loads that is drawn, less one
    TORQUE = 15  # logarithm of the share of wheel energy that the torque signal shows
    GENERATOR = 16  # logarithm of battery energy over motor energy while braking
    ROLL_DRIVE = 17  # of this drive: share of rolling resistance
    AUX_DRIVE = 18  # of this drive: W of standing load
    AUX = 19  # fast: W of standing load
    FORCE = 20  # fast: unseen force (wind, traffic), over the car's weight
    HEIGHT = 21  # fast: unseen height of the road, m
    SLOPE = 22  # fast: its derivative
    CLIMB = 23  # height gained over the present interval, m
    ENERGY = 24  # predicted since the battery was last measured, J


SIZE = len(State)
PARAMETERS = slice(0, State.NO_LOAD)
CAR = slice(0, State.ROLL_DRIVE)
LOGARITHMIC = (State.ETA, State.MU, State.MASS, State.C_D)

# Priors of the states that no vehicle file holds: mean and 1-sigma.
PRIORS = {
    # A drivetrain that turns idly takes 50 to 300 W in town, most of it bearings and oil.
    State.NO_LOAD: (150.0, 100.0),
    # Windings lose 1 to 3 kW of the 60 kW of a full launch at 3 m/s^2.
    State.COPPER: (200.0, 200.0),
    # Rolling resistance rises by some 0.6 % per K of cold (ISO 28580 corrects by 0.8 %).
    State.ROLL_COLD: (0.06, 0.05),
    # and is a sixth higher until tyres are warm, after half an hour (Ejsmont 2018).
    State.ROLL_START: (0.15, 0.10),
    # A small car loses some 60 W/K through walls and fresh air, half of it with a heat pump, and
    # takes twice as much until the cabin is warm (Lohse-Busch et al., SAE 2013-01-1462).
    State.COLD: (60.0, 60.0),
    State.HOT: (30.0, 40.0),
    State.COLD_START: (60.0, 50.0),
    State.HOT_START: (30.0, 40.0),
    State.REPORTED: (0.0, 0.15),
    # Inverters compute torque from currents, a few percent off.
    State.TORQUE: (0.0, 0.03),
    State.GENERATOR: (math.log(0.9), 0.06),
}
ROLL_WARM_TIME = 1200.0  # s in which tyres warm up
CABIN_TIME = 600.0  # s in which a cabin gets its temperature
MILD_CELSIUS = 20.0  # neither heated nor cooled

# 1-sigma of what is of one drive, how much of it the next drive still has (the season, a roof
# box), and how many drives this prior counts as when the variance is learned.
DRIVE_STD = {State.ROLL_DRIVE: 0.10, State.AUX_DRIVE: 250.0}
DRIVE_KEPT = 0.8
PRIOR_DRIVES = 4.0
DRIVES_KEPT = 30.0
# Drives that are compared may have nothing of that in common, and differ by this much more: other
# tyres (from class A to E of Regulation (EU) 2020/740 C_rr grows by half), heating in winter.
COMPARED_STD = {State.ROLL_DRIVE: 0.2, State.AUX_DRIVE: 1000.0}


class StatePrior(NamedTuple):
    """Mean and 1-sigma of every state, shape (SIZE,) each, the fast ones zero; covariance."""

    mean: np.ndarray
    std: np.ndarray
    covariance: np.ndarray


def prior_of(vehicle: Vehicle) -> StatePrior:
    """The prior of a car: its vehicle file and `PRIORS`."""
    mean, std = np.zeros(SIZE), np.zeros(SIZE)
    for index, parameter in enumerate(vehicle.priors.values()):
        if index in LOGARITHMIC:
            mean[index], std[index] = math.log(parameter.value), parameter.std / parameter.value
        elif index == State.C_RR:
            mean[index], std[index] = 1.0, parameter.std / parameter.value
        else:
            mean[index], std[index] = parameter.value, parameter.std
    for state, (value, sigma) in PRIORS.items():
        mean[state], std[state] = value, sigma
    correlation = np.eye(SIZE)
    correlation[PARAMETERS, PARAMETERS] = vehicle.correlation
    return StatePrior(mean, std, correlation * np.outer(std, std))
