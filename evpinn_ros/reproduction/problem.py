"""The loss of the paper on one drive: what every optimiser minimises (eq. 21 to 25).

What the paper leaves open is settled here; the effects are in `docs/explanation/paper.md`:

- inputs are speed in m/s and time in s since the start, as they are, or each mapped to [-1, 1];
- power is mapped to [-1, 1] between its extremes on the drive, for both terms alike;
- both terms are means over the samples, and lambda is inside the term called physics;
- a parameter is its initial value (eq. 24, 25) times exp(z), and z is learned: it stays positive,
  and one learning rate serves all five;
- P_aux is the median power at standstill (section III.C), else the vehicle file's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, TypeAlias

import numpy as np
import torch

from evpinn_ros.estimation.paper import LEARNED, PHYSICS_LOSS
from evpinn_ros.reproduction.drive_log import DriveLog
from evpinn_ros.reproduction.published import Losses
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.parameters import LIMITS, Parameters
from evpinn_ros.vehicle.physics import RegenForm, auxiliary_power

VALIDATION_SHARE = 0.2


Network: TypeAlias = Callable[[torch.Tensor], torch.Tensor]  # (n, 2) to (n,), both normalised


class InputForm(str, Enum):
    """Form in which the network takes speed and time."""

    RAW = "raw"  # m/s and s, as the paper states no normalisation
    UNIT = "unit"  # each mapped to [-1, 1] over the drive


@dataclass(frozen=True, slots=True)
class SampleSplit:
    """Indices of the samples to train on and of those to validate on, each rising."""

    training: np.ndarray
    validation: np.ndarray


def random_split(samples: int, seed: int) -> SampleSplit:
    """The paper's split: a fifth drawn at random. It measures interpolation in time, no more."""
    order = np.random.default_rng(seed).permutation(samples)
    held = round(samples * VALIDATION_SHARE)
    return SampleSplit(np.sort(order[held:]), np.sort(order[:held]))


def chronological_split(samples: int) -> SampleSplit:
    """The honest split: trained on the first four fifths, validated on the last."""
    border = samples - round(samples * VALIDATION_SHARE)
    return SampleSplit(np.arange(border), np.arange(border, samples))


@dataclass(frozen=True, slots=True)
class PowerScale:
    """Power, W, mapped to [-1, 1] between the extremes of a drive."""

    middle: float
    half_range: float

    @classmethod
    def of(cls, power: np.ndarray) -> PowerScale:
        """The scale of a drive; constant power counts as a range of 1 W."""
        low, high = float(power.min()), float(power.max())
        return cls((high + low) / 2, max((high - low) / 2, 1.0))


@dataclass(frozen=True, slots=True)
class InputScale:
    """Speed, m/s, and time, s, as the network takes them: (input - middle) / half_range."""

    middle: tuple[float, float]
    half_range: tuple[float, float]

    @classmethod
    def of(cls, log: DriveLog, form: InputForm) -> InputScale:
        """The scale of a drive; a constant input counts as a range of one unit."""
        if form is InputForm.RAW:
            return cls((0.0, 0.0), (1.0, 1.0))
        ends = [(float(c.min()), float(c.max())) for c in (log.speed, log.time)]
        speed, time = ends
        return cls(
            (sum(speed) / 2, sum(time) / 2),
            (max((speed[1] - speed[0]) / 2, 1.0), max((time[1] - time[0]) / 2, 1.0)),
        )


class PhysicsInputs(NamedTuple):
    """Inputs of eq. 21: speed, m/s, and acceleration, m/s^2, shape (n,) each."""

    speed: torch.Tensor
    acceleration: torch.Tensor


class Samples:
    """Samples of a drive as tensors: what the network takes and what it shall give."""

    def __init__(
        self,
        log: DriveLog,
        inputs: InputScale,
        scale: PowerScale,
        device: torch.device,
        dtype: torch.dtype,
    ) -> None:
        columns = (torch.as_tensor(column, dtype=dtype, device=device) for column in log)
        time, speed, acceleration, power = columns
        self.motion = PhysicsInputs(speed, acceleration)
        raw = torch.stack((speed, time), dim=1)
        self.inputs = (raw - raw.new_tensor(inputs.middle)) / raw.new_tensor(inputs.half_range)
        self.power = (power - scale.middle) / scale.half_range

    def __len__(self) -> int:
        return len(self.power)


class Problem:
    """One drive, one split, one reading of eq. 21: losses of a network and log parameters z."""

    def __init__(
        self,
        log: DriveLog,
        vehicle: Vehicle,
        split: SampleSplit,
        *,
        form: RegenForm = RegenForm.RECOVERY,
        inputs: InputForm = InputForm.RAW,
        device: str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.vehicle = vehicle = vehicle.as_published
        self.log, self.split, self.form = log, split, form
        self.device, self.dtype = torch.device(device), dtype
        self.inputs = InputScale.of(log, inputs)
        self.scale = PowerScale.of(log.power)
        self.p_aux = standstill_power(log.part(split.training), vehicle)
        self.training = self._samples(log.part(split.training))
        self.validation = self._samples(log.part(split.validation))
        self._initial = torch.tensor(
            [getattr(vehicle.initial, name) for name in LEARNED], dtype=dtype, device=self.device
        )

    def parameters(self, log_scale: torch.Tensor) -> Parameters:
        """The parameters at z, shape (5,), as tensors; P_aux is no free one."""
        return Parameters._make([*(self._initial * torch.exp(log_scale)), self.p_aux])

    def values(self, log_scale: torch.Tensor) -> Parameters:
        """The parameters at z as numbers; at z = 0 the initial values of eq. 24 and 25."""
        initial = self._initial.double() * torch.exp(log_scale.detach().double())
        return Parameters._make([*initial.tolist(), self.p_aux])

    def physics(self, motion: PhysicsInputs, log_scale: torch.Tensor) -> torch.Tensor:
        """Normalised P_physics of eq. 21 and 23, shape (n,)."""
        parameters = self.parameters(log_scale)
        power = self.vehicle.power(motion.speed, motion.acceleration, parameters, self.form)
        normalised: torch.Tensor = (power - self.scale.middle) / self.scale.half_range
        return normalised

    def terms(
        self, samples: Samples, network: Network, log_scale: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Data and physics term of eq. 22; their sum is the loss."""
        predicted = network(samples.inputs)
        data = torch.mean((samples.power - predicted) ** 2)
        physics = torch.mean((self.physics(samples.motion, log_scale) - predicted) ** 2)
        return data, PHYSICS_LOSS * physics

    @torch.no_grad()
    def losses(self, samples: Samples, network: Network, log_scale: torch.Tensor) -> Losses:
        """The same as numbers."""
        data, physics = (float(term) for term in self.terms(samples, network, log_scale))
        return Losses(data + physics, data, physics)

    @torch.no_grad()
    def predicted_power(self, network: Network, log: DriveLog) -> np.ndarray:
        """Power the network predicts, W, shape (n,)."""
        output = network(self._samples(log).inputs).double().cpu().numpy()
        return np.asarray(self.scale.middle + self.scale.half_range * output)

    def _samples(self, log: DriveLog) -> Samples:
        return Samples(log, self.inputs, self.scale, self.device, self.dtype)


def standstill_power(log: DriveLog, vehicle: Vehicle) -> float:
    """P_aux, W: the median power at standstill, else the vehicle file's."""
    standing = auxiliary_power(log.speed, log.power)
    return vehicle.initial.p_aux if np.isnan(standing) else max(standing, LIMITS["p_aux"].lower)
