"""Training of the Runge-Kutta network on synthetic power traces (eq. 30).

`python -m benchmarks.rknn_training OUT.npz` renews the shipped weights; the same seed on
the same machine gives the same file.

The paper's eq. 30 compares the network with "E_pred", which is circular. Here the reference is
the exact integral of each trace. To it the loss adds how far each k_i is from the power at its
moment ("each subnetwork sequentially learns the parameters k1..k4, similar to the classic
Runge-Kutta method"): eq. 30 alone fixes only their sum.

On unseen steps Adam comes to a loss of 1.2e-3; least squares for the output layers then brings it
to 6e-9 in a second. In short trials L-BFGS (4000 iterations) did not come near that, and
Levenberg-Marquardt (damping restarted every ten steps) needed six minutes.
"""

from __future__ import annotations

import itertools
from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
import torch
from torch import Tensor, nn

from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import printable
from evpinn_ros.energy.rknn import (
    ARGUMENTS,
    HIDDEN,
    SCALE,
    STEP_LIMIT,
    energy_step,
    normalised,
    restored,
    slopes,
)

SEED = 20240601
TRACES, KNOTS, STEPS_PER_TRACE = 128, 64, 32
SHORTEST_STEP = 0.005  # s
LEARNING_RATE = 1e-2  # of Adam, the paper's
ADAM_EPOCHS = 500


class TrainingSteps(NamedTuple):
    """Integration steps with known energy; each member of shape (n,), float64.

    Attributes:
        power: P(t), W.
        power_mid: P(t + dt/2), W.
        power_next: P(t + dt), W.
        dt: s.
        energy: exact integral of the power over the step, J.
    """

    power: Tensor
    power_mid: Tensor
    power_next: Tensor
    dt: Tensor
    energy: Tensor


class SubnetworkModule(nn.Module):
    """One of N1..N4 to be trained; the same function as `rknn.Subnetwork`."""

    def __init__(self, arguments: int) -> None:
        super().__init__()
        widths = itertools.pairwise((arguments, *HIDDEN))
        self.hidden = nn.ModuleList(nn.Linear(*pair, dtype=torch.float64) for pair in widths)
        self.output = nn.Linear(HIDDEN[-1], 1, dtype=torch.float64)

    def features(self, *arguments: Tensor) -> Tensor:
        """Last hidden layer, shape (n, 32), of power, W, and energy, J, each of shape (n,)."""
        x: Tensor = normalised(torch.stack(arguments, dim=-1))
        for layer in self.hidden:
            x = torch.tanh(layer(x))
        return x

    def forward(self, *arguments: Tensor) -> Tensor:
        """The slope, W, shape (n,), of power, W, and energy, J, each of shape (n,)."""
        slope: Tensor = restored(self.output(self.features(*arguments))[..., 0])
        return slope


class RknnModule(nn.Module):
    """The four subnetworks as one trainable module."""

    def __init__(self) -> None:
        super().__init__()
        self.n1, self.n2, self.n3, self.n4 = (SubnetworkModule(n) for n in ARGUMENTS)

    @property
    def networks(self) -> tuple[SubnetworkModule, ...]:
        """N1 to N4."""
        return self.n1, self.n2, self.n3, self.n4

    def forward(self, steps: TrainingSteps) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The slopes k1..k4, W, each of shape (n,)."""
        return slopes(self.networks, steps.power, steps.power_mid, steps.power_next, steps.dt)

    def weights(self) -> dict[str, np.ndarray]:
        """Weights and biases by the names that `rknn.load_rknn` reads."""
        arrays = {}
        for number, network in enumerate(self.networks, start=1):
            for layer, linear in enumerate((*network.hidden, network.output)):
                arrays[f"n{number}_weight{layer}"] = linear.weight.detach().numpy()
                arrays[f"n{number}_bias{layer}"] = linear.bias.detach().numpy()
        return arrays


def synthetic_steps(random: np.random.Generator, traces: int = TRACES) -> TrainingSteps:
    """Steps out of random power traces over the whole trained range.

    A trace is a random walk of the normalised power, folded into the range, from slow cruising
    to a full swing at every knot; between knots it is a monotone cubic. A step lies within one
    interval of the knots, where its integral is exact.
    """
    parts = []
    for _ in range(traces):
        spacing = SHORTEST_STEP * (STEP_LIMIT / SHORTEST_STEP) ** random.uniform()
        pace = 10 ** random.uniform(-2.0, 0.3)
        walk = random.uniform(-1, 1) + np.cumsum(pace * random.normal(size=KNOTS))
        folded = 1.02 * (np.abs((walk - 1) % 4 - 2) - 1)  # 2 % beyond: no edge at the limit
        time = spacing * np.arange(KNOTS)
        trace = PchipInterpolator(time, restored(folded))
        dt = spacing * random.uniform(0.2, 1.0, size=STEPS_PER_TRACE)
        start = random.choice(time[:-1], STEPS_PER_TRACE) + random.uniform(0, spacing - dt)
        energy = trace.antiderivative()(start + dt) - trace.antiderivative()(start)
        parts.append((trace(start), trace(start + dt / 2), trace(start + dt), dt, energy))
    return TrainingSteps(
        *(torch.from_numpy(np.concatenate(part)) for part in zip(*parts, strict=True))
    )


def loss(module: RknnModule, steps: TrainingSteps) -> Tensor:
    """Eq. 30 as relative error of the mean power, plus the error of each normalised slope."""
    ks = module(steps)
    at = (steps.power, steps.power_mid, steps.power_mid, steps.power_next)
    largest = torch.stack([power.abs() for power in at]).amax(dim=0)
    power_error = (energy_step(ks, steps.dt) - steps.energy) / steps.dt
    total: Tensor = (power_error / (SCALE + largest)).square().mean()
    for k, power in zip(ks, at, strict=True):
        total = total + (normalised(k) - normalised(power)).square().mean()
    return total


def adam_epochs(module: RknnModule, steps: TrainingSteps, epochs: int) -> None:
    """Train all weights by Adam, full batches, the rate falling along a cosine."""
    adam = torch.optim.Adam(module.parameters(), lr=LEARNING_RATE)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(adam, epochs)
    for _ in range(epochs):
        adam.zero_grad()
        loss(module, steps).backward()  # type: ignore[no-untyped-call]
        adam.step()
        decay.step()


@torch.no_grad()
def solve_outputs(module: RknnModule, steps: TrainingSteps) -> None:
    """Fit the output layers exactly, N1 to N4 in turn, each to the power at its moment.

    An output layer is linear, so least squares finds in one go the digits no descent reaches.
    """
    half = steps.dt / 2
    k1 = _solve_output(module.n1, steps.power)
    k2 = _solve_output(module.n2, steps.power_mid, half * k1)
    k3 = _solve_output(module.n3, steps.power_mid, half * k2)
    _solve_output(module.n4, steps.power_next, steps.dt * k3)


def _solve_output(network: SubnetworkModule, *arguments: Tensor) -> Tensor:
    features = network.features(*arguments)
    columns = torch.cat([features, torch.ones_like(features[:, :1])], dim=1)
    wanted = normalised(arguments[0])[:, None]
    # gelsd drops directions that the features do not span, which keeps the weights moderate.
    solution = torch.linalg.lstsq(columns, wanted, rcond=1e-9, driver="gelsd").solution[:, 0]
    network.output.weight.copy_(solution[None, :-1])
    network.output.bias.copy_(solution[-1:])
    slope: Tensor = network(*arguments)
    return slope


def train(seed: int = SEED, epochs: int = ADAM_EPOCHS, traces: int = TRACES) -> RknnModule:
    """Adam on all weights as in the paper, then least squares for the output layers."""
    torch.manual_seed(seed)
    module = RknnModule()
    random = np.random.default_rng(seed)
    adam_epochs(module, synthetic_steps(random, traces), epochs)
    solve_outputs(module, synthetic_steps(random, 16 * traces))
    return module


def main(arguments: list[str]) -> int:
    """Train and write the weights to the path given; the exit code."""
    if len(arguments) != 1:
        print(printable("usage: python -m benchmarks.rknn_training OUT.npz"), file=sys.stderr)
        return 2
    limit_blas_threads()
    module = train()
    np.savez(Path(arguments[0]), **module.weights())  # type: ignore[arg-type]
    unseen = loss(module, synthetic_steps(np.random.default_rng(SEED + 1)))
    print(printable(f"loss on unseen steps: {unseen.item():.1e}"), file=sys.stderr)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
