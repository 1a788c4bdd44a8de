"""The paper's Runge-Kutta neural network: energy from power (section III.E, eq. 25-29).

Four subnetworks N1..N4 give the slopes k1..k4 of one fourth-order Runge-Kutta step. Each has
three hidden layers of 32 tanh units. Three choices the paper leaves open:

- **Normalisation.** Powers and energies enter as asinh(x / 1 kW) and asinh(x / 1 kJ), scaled to
  [-1, 1] at the limit of the trained range; outputs leave through the inverse. It is linear for
  small and logarithmic for large values, so that an error of the network is a share *of the
  power*: 1 kW of standstill is integrated as well as 200 kW.
- **Origin of energy.** E enters relative to the start of the step, E(t) = 0. dE/dt does not
  depend on E, and the energy of a whole drive would leave the trained range within minutes. With
  it the steps of a series are independent, so a whole series is one batched evaluation.
- **P(t + dt/2)** is an argument; by default the mean of both ends, which is linear interpolation.

With the shipped weights the network differs from the quadrature of the same power by less than
0.01 % of the net energy of real drives. Without a state in dE/dt a Runge-Kutta step *is* Simpson's
rule, so it gains where the midpoint is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

SCALE = 1e3  # W and J: where the normalisation turns from linear to logarithmic
POWER_LIMIT = 5e5  # W: trained range; a step with power beyond it is Simpson's rule itself
STEP_LIMIT = 2.0  # s: longest step of the trained range
HIDDEN = (32, 32, 32)
ARGUMENTS = (1, 2, 2, 2)  # of N1 to N4: power, then energy
SHIPPED_WEIGHTS = Path(__file__).with_name("rknn_weights.npz")

_SPAN = math.asinh(POWER_LIMIT / SCALE)

Slope: TypeAlias = Callable[..., Any]


def normalised(value: Any) -> Any:
    """Power, W, or energy, J, as the subnetworks see it; floats, arrays or tensors."""
    scaled = value / SCALE
    return (scaled.asinh() if hasattr(scaled, "asinh") else np.arcsinh(scaled)) / _SPAN


def restored(value: Any) -> Any:
    """The power, W, that `normalised` maps to this value."""
    stretched = value * _SPAN
    return SCALE * (stretched.sinh() if hasattr(stretched, "sinh") else np.sinh(stretched))


def slopes(
    networks: Sequence[Slope],
    power: Any,
    power_mid: Any,
    power_next: Any,
    dt: Any,
    energy: Any = 0.0,
) -> tuple[Any, Any, Any, Any]:
    """The slopes k1 to k4 of eq. 26-29, W, elementwise, arrays or tensors.

    Args:
        networks: N1(P), N2(P, E), N3(P, E) and N4(P, E), from W and J to W.
        power: P(t), W.
        power_mid: P(t + dt/2), W.
        power_next: P(t + dt), W.
        dt: s.
        energy: E(t), J; the trained network takes it as zero.
    """
    n1, n2, n3, n4 = networks
    k1 = n1(power)
    k2 = n2(power_mid, energy + dt / 2 * k1)
    k3 = n3(power_mid, energy + dt / 2 * k2)
    k4 = n4(power_next, energy + dt * k3)
    return k1, k2, k3, k4


def energy_step(ks: tuple[Any, Any, Any, Any], dt: Any) -> Any:
    """E(t + dt) - E(t) of eq. 25, J, from the four slopes, W."""
    k1, k2, k3, k4 = ks
    return dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@dataclass(frozen=True, slots=True)
class Subnetwork:
    """One of N1..N4: weights (outputs, inputs) and biases (outputs,) of each layer."""

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]

    def __call__(self, *arguments: Any) -> Any:
        """The slope, W, of power, W, and energy, J: floats or arrays of shape (n,)."""
        x = normalised(np.array(arguments).T)
        for weight, bias in self.layers[:-1]:
            x = np.tanh(x @ weight.T + bias)
        weight, bias = self.layers[-1]
        return restored(x @ weight[0] + bias[0])


@dataclass(frozen=True, slots=True)
class Rknn:
    """A trained Runge-Kutta network, evaluated with numpy."""

    networks: tuple[Slope, ...]  # N1 to N4

    def step(self, power: Any, power_next: Any, dt: Any, power_mid: Any = None) -> Any:
        """Energy of one step, or of many independent ones, J.

        Args:
            power: P(t), W, a float or shape (n,) as all.
            power_next: P(t + dt), W.
            dt: s; beyond `STEP_LIMIT` or `POWER_LIMIT`, Simpson's rule is used.
            power_mid: P(t + dt/2), W; None for the mean of both ends.
        """
        middle = (power + power_next) / 2 if power_mid is None else power_mid
        if isinstance(power, float):  # as arrays of one number it would take a third longer
            if max(abs(power), abs(middle), abs(power_next)) > POWER_LIMIT or dt > STEP_LIMIT:
                return energy_step((power, middle, middle, power_next), dt)
            return energy_step(slopes(self.networks, power, middle, power_next, dt), dt)
        beyond = np.abs([power, middle, power_next]).max(axis=0) > POWER_LIMIT
        beyond = beyond | (np.asarray(dt) > STEP_LIMIT)
        p0, p1, p2 = (np.clip(p, -POWER_LIMIT, POWER_LIMIT) for p in (power, middle, power_next))
        energy = energy_step(slopes(self.networks, p0, p1, p2, dt), dt)
        if not np.any(beyond):
            return energy
        return np.where(beyond, energy_step((power, middle, middle, power_next), dt), energy)


def load_rknn() -> Rknn:
    """The network of the weights that come with the package."""
    networks = []
    with np.load(SHIPPED_WEIGHTS, allow_pickle=False) as weights:
        for name in ("n1", "n2", "n3", "n4"):
            layers = range(len(HIDDEN) + 1)
            pairs = ((weights[f"{name}_weight{i}"], weights[f"{name}_bias{i}"]) for i in layers)
            networks.append(Subnetwork(tuple(pairs)))
    return Rknn(tuple(networks))
