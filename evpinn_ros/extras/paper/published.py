"""Published figures of the paper, by names of vehicle files.

Source: H. Lim et al., "EV-PINN: A Physics-Informed Neural Network for Predicting Electric Vehicle
Dynamics", Tables II to VI and section III.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from evpinn_ros.core.vehicle.parameters import Parameters

LOGGED_EPOCHS = (1, 10, 100, 1000, 10_000)  # rows of Tables II, III and IV


class Losses(NamedTuple):
    """Eq. 22 and its two terms, as the columns of Tables II and III: total = data + physics."""

    total: float
    data: float
    physics: float


class LossRow(NamedTuple):
    """Losses at one epoch, on the training and on the validation data."""

    epoch: int
    training: Losses
    validation: Losses


class EnergyRow(NamedTuple):
    """Losses of eq. 30 at an epoch of Table IV; ours are over the mean square energy of a step."""

    epoch: int
    rknn_training: float
    rknn_validation: float
    dnn_training: float
    dnn_validation: float


class ComparedVehicle(NamedTuple):
    """A row of Table VI: the vehicle, the name of its vehicle file, its values."""

    title: str
    vehicle: str
    eta: float
    mass: float
    c_rr: float
    c_d: float


def _loss_rows(*losses: tuple[float, ...]) -> tuple[LossRow, ...]:
    rows = zip(LOGGED_EPOCHS, losses, strict=True)
    return tuple(LossRow(epoch, Losses(*row[:3]), Losses(*row[3:])) for epoch, row in rows)


POWER_LOSSES: Mapping[str, tuple[LossRow, ...]] = {
    "tesla_model_3_lr": _loss_rows(
        (35.527561, 0.0277841, 35.499778, 11.830781, 0.0308733, 11.799907),
        (4.3677359, 0.0397093, 4.3280265, 2.8024990, 0.0390067, 2.7634923),
        (0.1390878, 0.0314255, 0.1076622, 0.1379689, 0.0314022, 0.1065666),
        (0.0219033, 0.0115064, 0.0103969, 0.0182797, 0.0115101, 0.0067695),
        (0.0021949, 0.0014924, 0.0007025, 0.0022917, 0.0015515, 0.0007402),
    ),
    "tesla_model_s": _loss_rows(
        (95.58700, 0.0409975, 95.54600, 40.465814, 0.0372440, 40.428570),
        (9.0055013, 0.0258939, 8.9796073, 5.8529850, 0.0266144, 5.8263706),
        (0.1297769, 0.0270814, 0.102695, 0.1253943, 0.0267145, 0.0986798),
        (0.0364526, 0.0175198, 0.018932, 0.0354756, 0.0172076, 0.0182680),
        (0.0035389, 0.0015508, 0.0019881, 0.0033812, 0.0013860, 0.0019952),
    ),
}

ENERGY_LOSSES = (
    EnergyRow(1, 0.9869467, 0.9185590, 1.0588666, 0.9831669),
    EnergyRow(10, 0.3569548, 0.3176739, 0.2055948, 0.2005833),
    EnergyRow(100, 0.0108608, 0.0106572, 0.0623520, 0.0723817),
    EnergyRow(1000, 0.0024956, 0.0026879, 0.0063364, 0.0059875),
    EnergyRow(10_000, 0.0002584, 0.0003183, 0.0007926, 0.0008287),
)

# Table V; P_aux by section III.C.
PREDICTED: Mapping[str, Parameters] = {
    "tesla_model_3_lr": Parameters(0.7349, 0.6743, 1975.0, 0.00915, 0.2349, 1100.0),
    "tesla_model_s": Parameters(0.7248, 0.7038, 2313.0, 0.01100, 0.2457, 390.0),
}

COMPARED = (
    ComparedVehicle("BMW i4", "bmw_i4", 0.75, 2125, 0.014, 0.24),
    ComparedVehicle("Chevy Bolt", "chevrolet_bolt", 0.72, 1628, 0.011, 0.28),
    ComparedVehicle("Hyundai Ioniq 6", "hyundai_ioniq_6", 0.75, 2086, 0.0065, 0.21),
    ComparedVehicle("Tesla Model 3", "tesla_model_3_lr", 0.70, 1823, 0.0096, 0.23),
)
