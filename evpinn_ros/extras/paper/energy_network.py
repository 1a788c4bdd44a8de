"""The paper's Runge-Kutta network for energy, as published, beside a plain network (Table IV).

N1 to N4 of eq. 26-29 have three tanh layers of 32 each; the plain network (DNN) has three of 65,
1.2 % more weights. Both are trained by Adam, rate 1e-2, with one batch of all training steps per
epoch, on the same random 80/20 split. Choices that the paper leaves open:

- **Reference.** E_RK4 is classical Runge-Kutta on the measured power, with P(t + dt/2) the mean of
both ends: the trapezoid.

- **Loss.** A mean, as Table IV must be. E(t) is the true energy and cancels: each loss is that of
the energy of a step.

- **Units.** The mean dt and the RMS energy of a step, so that eq. 25 keeps its form and a network
with output 0 has loss 1. E(t) is scaled to -1 to 1.

- **DNN.** It maps P(t), P(t + dt/2), P(t + dt), E(t) and dt to the energy of the step.

- **Initial weights** are PyTorch's own; with Glorot's rule the DNN started at losses 0.8 to 1.5.

- **Epoch** n of the table is the loss before the n-th update: epoch 1 is untrained.

- **Split.** Neighbours of validation steps are training data: the loss is not that of a new drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
import itertools
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.rknn import ARGUMENTS, HIDDEN, energy_step, slopes
from evpinn_ros.extras.paper.checkpoint import adam_state, load_adam_state
from evpinn_ros.extras.paper.published import EnergyRow

# For Fig. 8: up to 50 epochs per decade, including those of the table.
CURVE_EPOCHS = frozenset(round(10 ** (i / 50)) for i in range(201))
DNN_HIDDEN = (65, 65, 65)
LEARNING_RATE = 1e-2
TRAINING_SHARE = 0.8
MAX_GAP = 2.5  # s; power is unknown between samples further apart
MIN_STEPS = 50
SETTLED = 1e-9  # mean steps: change below which a roll-out has converged


class StepData(NamedTuple):
    """Steps between neighbouring samples of power, shape (n,) each: float64 arrays or tensors."""

    power: Any  # P(t), W
    power_mid: Any  # P(t + dt/2), W
    power_next: Any  # P(t + dt), W
    dt: Any  # s
    energy: Any  # E(t), J, integrated since the first sample
    step_energy: Any  # E(t + dt) - E(t), J


def step_data(time: np.ndarray, power: np.ndarray) -> StepData:
    """Steps to train on and their energy, of time, s, and power, W; InputError for too few.

    Steps that are longer than `MAX_GAP`, not forward in time or not finite are left out.
    """
    steps, _ = _usable_steps(time, power)
    if len(steps.dt) < MIN_STEPS:
        raise InputError(f"{len(steps.dt)} usable steps of power, expected {MIN_STEPS} or more")
    if not steps.step_energy.any():
        raise InputError("the power is zero throughout: there is no energy to learn")
    return steps


def _usable_steps(time: np.ndarray, power: np.ndarray) -> tuple[StepData, np.ndarray]:
    """The steps that can be integrated, and the index of the first sample of each."""
    dt = np.diff(time)
    has_power = np.isfinite(power[:-1]) & np.isfinite(power[1:])
    starts = np.flatnonzero(has_power & (dt > 0) & (dt <= MAX_GAP))
    start, end, dt = power[starts], power[starts + 1], dt[starts]
    middle = (start + end) / 2
    gained = energy_step((start, middle, middle, end), dt)
    energy = np.cumsum(gained) - gained
    return StepData(start, middle, end, dt, energy, gained), starts


class _Units(NamedTuple):
    """Unit of time, s, and of energy, J; power is measured in their quotient."""

    time: float
    energy: float

    def scaled(self, steps: StepData, dtype: torch.dtype) -> StepData:
        """Steps in these units, as tensors."""
        power = self.energy / self.time
        units = (power, power, power, self.time, self.energy, self.energy)
        pairs = zip(steps, units, strict=True)
        return StepData(*(torch.as_tensor(values / unit, dtype=dtype) for values, unit in pairs))


class _TanhNetwork(nn.Module):
    """Tanh layers and a linear one; arguments are first divided by their scales."""

    scales: Tensor

    def __init__(self, scales: Sequence[float], hidden: Sequence[int]) -> None:
        super().__init__()
        self.register_buffer("scales", torch.tensor(scales))
        layers: list[nn.Module] = []
        for pair in itertools.pairwise((len(scales), *hidden)):
            layers += [nn.Linear(*pair), nn.Tanh()]
        self.layers = nn.Sequential(*layers, nn.Linear(hidden[-1], 1))

    def forward(self, *arguments: Tensor) -> Tensor:
        output: Tensor = self.layers(torch.stack(arguments, dim=-1) / self.scales)
        return output[..., 0]


class _Networks(nn.Module):
    """The RKNN and the DNN."""

    def __init__(self, energy_span: float) -> None:
        super().__init__()
        self.subnetworks = nn.ModuleList(
            _TanhNetwork((1.0, energy_span)[:n], HIDDEN) for n in ARGUMENTS
        )
        self.plain = _TanhNetwork((1.0, 1.0, 1.0, 1.0, energy_span), DNN_HIDDEN)

    def forward(self, steps: StepData, energy: Tensor) -> Tensor:
        """Energy of each step, shape (2, n), RKNN first, when E(t) is `energy`, shape (2, n)."""
        inputs = steps.power, steps.power_mid, steps.power_next, steps.dt
        ks = slopes(list(self.subnetworks), *inputs, energy[0])
        return torch.stack((energy_step(ks, steps.dt), self.plain(*inputs, energy[1])))

    def losses(self, steps: StepData) -> Tensor:
        """Mean losses of eq. 30, shape (2,), RKNN first."""
        errors: Tensor = self(steps, steps.energy.expand(2, -1)) - steps.step_energy
        return errors.square().mean(dim=1)

    def rolled_out(self, steps: StepData) -> Tensor:
        """Energy of each step from the sum of earlier ones, shape (2, n), RKNN first.

        It iterates over all steps at once: as E hardly matters, six iterations do for thousands.
        """
        energy: Tensor = steps.energy.expand(2, -1)
        gained: Tensor = steps.step_energy.expand(2, -1)
        for _ in steps.dt:
            gained = self(steps, energy)
            before, energy = energy, gained.cumsum(1) - gained
            if not ((energy - before).abs() > SETTLED).any():
                break
        return gained


class EnergyTraining:
    """Training of both networks; interrupted and resumed, it gives the same numbers."""

    def __init__(self, data: StepData, *, seed: int, device: str = "cpu") -> None:
        """Make untrained networks on a torch device; the seed draws weights and split."""
        self.losses: list[EnergyRow] = []  # at the epochs of `CURVE_EPOCHS` so far
        self.epoch = 0  # epochs trained
        self._units = _Units(float(data.dt.mean()), float((data.step_energy**2).mean() ** 0.5))
        steps = self._units.scaled(data, torch.float32)
        with torch.random.fork_rng(devices=[]):  # keeps the caller's random state
            torch.manual_seed(seed)
            shuffled = torch.randperm(len(data.dt))
            reached = steps.energy + steps.step_energy
            self._networks = _Networks(float(reached.abs().max())).to(device)
        parts = shuffled.tensor_split([round(TRAINING_SHARE * len(shuffled))])
        self._train, self._validation = (
            StepData(*(column[rows].to(device) for column in steps)) for rows in parts
        )
        # One Adam for both: it treats every weight separately.
        self._adam = torch.optim.Adam(self._networks.parameters(), LEARNING_RATE, foreach=True)

    def run_to(self, epoch: int, on_epoch: Callable[[int, float], None] | None = None) -> None:
        """Train on eq. 30 up to this epoch; InputError if a loss is not finite."""
        while self.epoch < epoch:
            losses = self._networks.losses(self._train)
            number, (rknn, dnn) = self.epoch + 1, losses.tolist()
            if not np.isfinite((rknn, dnn)).all():
                raise InputError(f"training of energy diverged at epoch {number}")
            if number in CURVE_EPOCHS:
                with torch.no_grad():
                    rknn_val, dnn_val = self._networks.losses(self._validation).tolist()
                self.losses.append(EnergyRow(number, rknn, rknn_val, dnn, dnn_val))
            self._adam.zero_grad()
            losses.sum().backward()  # type: ignore[no-untyped-call]
            self._adam.step()
            self.epoch = number
            if on_epoch is not None:
                on_epoch(number, rknn)

    def state(self) -> dict[str, Tensor]:
        """State of the training, for `load_state`."""
        state = {"epoch": torch.tensor(self.epoch)}
        state["losses"] = torch.tensor(self.losses, dtype=torch.float64).reshape(-1, 5)
        for name, value in self._networks.state_dict().items():
            state[f"networks_{name}"] = value.clone()
        return state | adam_state(self._adam, self._networks.parameters())

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Continue from a `state` of the same data and seed."""
        self.epoch = int(state["epoch"])
        self.losses = [EnergyRow(int(row[0]), *row[1:]) for row in state["losses"].tolist()]
        weights = self._networks.state_dict()
        self._networks.load_state_dict({name: state[f"networks_{name}"] for name in weights})
        load_adam_state(self._adam, self._networks.parameters(), state)

    @torch.no_grad()
    def integrate(self, time: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy by RKNN and by DNN, J, (n,), each step from the network's own sum (Fig. 9)."""
        steps, starts = _usable_steps(time, power)
        networks = deepcopy(self._networks).cpu().double()
        gained = np.zeros((2, len(time)))
        gained[:, starts + 1] = networks.rolled_out(self._units.scaled(steps, torch.float64))
        rknn, dnn = np.cumsum(gained, axis=1) * self._units.energy
        if not np.isfinite((rknn, dnn)).all():
            raise InputError("training of energy diverged in its last epoch")
        return rknn, dnn
