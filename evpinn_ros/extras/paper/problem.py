"""The loss of the paper on one drive, which every optimizer minimises (eq. 21 to 25).

Choices that the paper leaves open, with effects in `docs/explanation/paper.md`:

- inputs are speed in m/s and time in s since the start, unscaled or each mapped to [-1, 1];
- power is mapped to [-1, 1] between its extremes on the drive, in both terms;
- both terms are means over the samples, and the physics term includes lambda;
- parameters are learned as logarithms z over their initial values (`extras.paper.log_parameters`);
- P_aux is the median power at standstill (section III.C), else the vehicle file's.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple, TypeAlias

import numpy as np
import torch

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.drive_log import DriveLog
from evpinn_ros.extras.paper.log_parameters import (
    LEARNED,
    LogParameters,
    ParameterFit,
    standing_load,
)
from evpinn_ros.extras.paper.network import PHYSICS_LOSS
from evpinn_ros.extras.paper.published import Losses

VALIDATION_SHARE = 0.2


Network: TypeAlias = Callable[[torch.Tensor], torch.Tensor]  # (n, 2) to (n,), both normalised


class InputForm(str, Enum):
    """Scaling of the network's inputs, speed and time."""

    RAW = "raw"  # m/s and s, as the paper states no normalisation
    UNIT = "unit"  # each mapped to [-1, 1] over the drive


class SampleSplit(NamedTuple):
    """Indices of the training samples and of the validation samples, each rising."""

    training: np.ndarray
    validation: np.ndarray


def random_split(samples: int, seed: int) -> SampleSplit:
    """The paper's split: validation on a random fifth, which only tests interpolation in time."""
    order = np.random.default_rng(seed).permutation(samples)
    held = round(samples * VALIDATION_SHARE)
    return SampleSplit(np.sort(order[held:]), np.sort(order[:held]))


def chronological_split(samples: int) -> SampleSplit:
    """Split in time: training on the first four fifths, validation on the last."""
    border = samples - round(samples * VALIDATION_SHARE)
    return SampleSplit(np.arange(border), np.arange(border, samples))


class Scale(NamedTuple):
    """Scaling of an input or output of the network: (value - middle) / half_range."""

    middle: float
    half_range: float

    @classmethod
    def of(cls, values: np.ndarray) -> Scale:
        """The scale that maps values to [-1, 1]; a constant has range 1."""
        low, high = float(values.min()), float(values.max())
        return cls((high + low) / 2, max((high - low) / 2, 1.0))

    def normalised(self, values: torch.Tensor) -> torch.Tensor:
        """Values as inputs or targets of the network."""
        return (values - self.middle) / self.half_range

    def restored(self, values: torch.Tensor) -> np.ndarray:
        """Values of the network in their original unit, float64."""
        return np.asarray(self.middle + self.half_range * values.double().cpu().numpy())


RAW = Scale(0.0, 1.0)  # unscaled


class SampleTensors(NamedTuple):
    """Samples of a drive as tensors: inputs of eq. 21 and of the network, and the target."""

    speed: torch.Tensor  # m/s, shape (n,)
    acceleration: torch.Tensor  # m/s^2, shape (n,)
    inputs: torch.Tensor  # of the network: speed and time, shape (n, 2)
    power: torch.Tensor  # normalised, shape (n,)


class Problem:
    """Losses of a network and log parameters z, for one drive, split and form of eq. 21."""

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
        raw = inputs is InputForm.RAW
        self.inputs = (RAW, RAW) if raw else (Scale.of(log.speed), Scale.of(log.time))
        self.scale = Scale.of(log.power)
        trained = chosen_rows(log, split.training)
        self.p_aux = standing_load(trained.speed, trained.power, vehicle.initial.p_aux)
        self.training = self._samples(trained)
        self.validation = self._samples(chosen_rows(log, split.validation))
        self._parameters = LogParameters(vehicle)

    def values(self, log_scale: torch.Tensor) -> Parameters:
        """The parameters at z, shape (5,); at z = 0 the initial values of eq. 24 and 25."""
        return self._parameters.values(log_scale, self.p_aux)

    def physics(self, samples: SampleTensors, log_scale: torch.Tensor) -> torch.Tensor:
        """Normalised P_physics of eq. 21 and 23, shape (n,)."""
        parameters = self._parameters.tensors(log_scale, self.p_aux)
        power = self.vehicle.power(samples.speed, samples.acceleration, parameters, self.form)
        return self.scale.normalised(power)

    def fit(
        self, samples: SampleTensors, power: torch.Tensor, start: torch.Tensor | None = None
    ) -> ParameterFit:
        """The z, from `start`, with the best fit of the physics to a normalised power, (n,)."""
        if start is None:
            start = torch.zeros(len(LEARNED), dtype=self.dtype, device=self.device)
        return self._parameters.fit(
            lambda z: self.physics(samples, z), power, start, self.scale.half_range
        )

    def covariance(self, log_scale: torch.Tensor) -> np.ndarray:
        """Covariance of z, shape (5, 5), from the power of the training samples and the priors."""
        training = self.training
        return self._parameters.covariance(
            lambda z: self.physics(training, z), training.power, log_scale, self.scale.half_range
        )

    def terms(
        self, samples: SampleTensors, network: Network, log_scale: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Data and physics term of eq. 22; their sum is the loss."""
        predicted = network(samples.inputs)
        data = torch.mean((samples.power - predicted) ** 2)
        physics = torch.mean((self.physics(samples, log_scale) - predicted) ** 2)
        return data, PHYSICS_LOSS * physics

    @torch.no_grad()
    def losses(self, samples: SampleTensors, network: Network, log_scale: torch.Tensor) -> Losses:
        """Data and physics term of eq. 22 as numbers."""
        data, physics = (float(term) for term in self.terms(samples, network, log_scale))
        return Losses(data + physics, data, physics)

    @torch.no_grad()
    def predicted_power(self, network: Network, log: DriveLog) -> np.ndarray:
        """Predicted power of the network, W, shape (n,)."""
        return self.scale.restored(network(self._samples(log).inputs))

    def _samples(self, log: DriveLog) -> SampleTensors:
        columns = (torch.as_tensor(column, dtype=self.dtype, device=self.device) for column in log)
        time, speed, acceleration, power = columns
        scaled = [
            scale.normalised(raw) for scale, raw in zip(self.inputs, (speed, time), strict=True)
        ]
        inputs = torch.stack(scaled, dim=1)
        return SampleTensors(speed, acceleration, inputs, self.scale.normalised(power))
