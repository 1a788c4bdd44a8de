"""A map of losses that cars share, as prior of the network: an experiment, not the default.

k tanh networks of speed and wheel force are learned from all recorded cars but one, by the
likelihood of their energies, with the core's other states of a car marginalised. In the car left
out they replace the weakest k directions of the core's network, with the mean and 1-sigma of the
other cars. Each of its drives is scored as that of a new car, on intervals.

Run: OMP_NUM_THREADS=1 python -m benchmarks.shared_map DATA
"""

from __future__ import annotations

from collections.abc import Sequence
import sys
from typing import Any, TypeAlias

import numpy as np
import torch

from benchmarks.variants import ConstantPlace, RecordedCar, Variant, read_car, score
from evpinn_ros.cli.console import say
from evpinn_ros.core.energy.network_table import FORCES, GRID_FORCE, GRID_SPEED, places_of
from evpinn_ros.core.estimation import network, posterior, terms
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.states import NETWORK, PHYSICS, SIZE, WEIGHTS
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.vehicle.physics import GRAVITY

CARS = ("model3", "i3", "e208", "changchun", "leaf2013", "three_wheeler",
        "{}/ved_plug_in/v1.csv.gz=generic")  # fmt: skip
TRIED = (2, True), (4, True), (4, False)  # k, and whether maps are orthogonal to eq. 21
LEARNED, SCORED, LEAST = 8, 12, 450.0  # drives of each car, s of a drive
TOP = 46  # nodes of speed that are learned, 1 m/s apart
UNITS, STEPS, RATE, WEIGHT = 16, 300, 0.02, 50.0  # of training; N of an output weight of 1
# Energies of n intervals less the prior's, and of 1 N at each node of a map, (n, nodes); whitened.
Energies: TypeAlias = tuple[torch.Tensor, torch.Tensor]


class SharedMap(torch.nn.Module):
    """k networks of speed, m/s, and force over mass, m/s^2, and the mean of their weights."""

    def __init__(self, outputs: int, cars: Sequence[Energies]) -> None:
        """The likeliest map of cars."""
        super().__init__()
        rng, shapes = torch.Generator().manual_seed(0), ((UNITS, 2), (UNITS,), (UNITS, outputs))
        drawn = [torch.randn(*shape, generator=rng).double() for shape in shapes]
        drawn = [network.SPREAD * drawn[0], drawn[1], 0.3 * drawn[2], 0.0 * drawn[2][0]]
        self.inner, self.bias, self.outer, self.mean = map(torch.nn.Parameter, drawn)
        adam = torch.optim.Adam(self.parameters(), lr=RATE)
        for _ in range(STEPS):
            adam.zero_grad()
            self.lost(cars).backward()  # type: ignore[no-untyped-call]
            adam.step()

    def lost(self, cars: Sequence[Energies]) -> torch.Tensor:
        """Negative log likelihood of cars whose weights have a 1-sigma of 1, and of its own."""
        speed, force = np.meshgrid(GRID_SPEED[:TOP], GRID_FORCE, indexing="ij")
        scaled = (speed - network.SPEED_CENTRE) / network.SPEED_SCALE, force / network.FORCE_SCALE
        inputs = torch.tensor(np.stack(scaled, -1).reshape(-1, 2))
        forces = torch.tanh(inputs @ self.inner.T + self.bias) @ (WEIGHT * self.outer)
        lost = (self.outer**2).sum() + (self.mean**2).sum()
        lost = lost + 0.1 * (self.inner**2).sum() / network.SPREAD**2
        for energy, nodes in cars:
            maps = nodes @ forces
            away, gram = energy - maps @ self.mean, torch.eye(len(self.mean)) + maps.T @ maps
            along = torch.linalg.solve(gram, maps.T @ away)
            lost = lost + away @ away - away @ maps @ along + torch.logdet(gram)
        return 0.5 * lost

    def in_core(self, orthogonal: bool) -> dict[ConstantPlace, Any]:
        """What to replace in the core: its network, and the state of a new car."""
        inner, bias, outer, mean = (w.detach().numpy() for w in self.parameters())
        count = len(mean)

        def joined(seed: int, driving: network.Driving, *at: np.ndarray) -> network.Network:
            core = network.orthogonal_network(seed, driving, *at)
            both = np.zeros((network.UNITS + UNITS, NETWORK))
            both[: network.UNITS, :-count] = core.outer[:, :-count]
            both[network.UNITS :, -count:] = WEIGHT * outer
            units = np.vstack((core.inner, inner)), np.concatenate((core.bias, bias))
            whole = network.Network(*units, both, core.explained)
            power = driving.speed[:, None] * whole.force(driving.speed, at[0])
            explained = network.share_of_terms(driving, at[1], power)
            explained[:, -count:] *= orthogonal
            return whole._replace(explained=explained)

        def initial(equation: terms.Equation) -> posterior.CarState:
            state, last = posterior.initial_state(equation), np.arange(SIZE)[-count:]
            state.mean[:, last], state.covariance[:, last, last] = mean, 1.0
            return state

        networks = ConstantPlace("terms", "orthogonal_network")
        return {networks: joined, ConstantPlace("car", "initial_state"): initial}


def whitened(recorded: RecordedCar, orthogonal: bool) -> Energies:
    """Whitened energies of a car's drives, each as the first drive of a new car."""
    equation, drives, whole = terms.Equation(recorded.vehicle), some(recorded, LEARNED), []
    car = LearnedCar.new(equation)
    for drive in drives:
        car = car.begin_drive().after(drive)
    covariance, scale = equation.covariance.copy(), car.state.weights @ car.state.scale
    covariance[WEIGHTS, WEIGHTS] = posterior.NETWORK_STDS[0] ** 2 * np.eye(NETWORK)
    driving = network.reference_driving()
    v, a, slope, _ = driving
    moved = equation.wheels(v**0, v, v**3, v * a, v * slope, recorded.vehicle.air_density)
    explained = network.share_of_terms(driving, moved.terms, on_grid(moved)) * orthogonal
    for drive in drives:
        seconds = np.cumsum([0.0, *(interval.duration for interval in drive)])
        pairs = zip(drive, seconds, strict=False)
        along = [posterior.interval_terms(equation, *pair) for pair in pairs]
        rows = np.array([part.journey.row for part in along])
        noise = [scale @ p.journey.noise + p.interval.sampling_variance for p in along]
        root = np.linalg.cholesky(rows @ covariance @ rows.T + np.diag(noise))
        energy = np.array([interval.energy for interval in drive]) - rows @ equation.mean
        nodes = np.array([on_grid(p.wheels).sum(0) for p in along]) - rows[:, PHYSICS] @ explained
        whole.append(np.linalg.solve(root, np.column_stack((energy, nodes))))
    white = np.vstack(whole)
    white /= max(1.0, float(np.sqrt(np.mean(white[:, 0] ** 2))))  # heavy tails count less
    return torch.tensor(white[:, 0]), torch.tensor(white[:, 1:])


def on_grid(wheels: terms.Wheels) -> np.ndarray:
    """Energy of n steps by a force of 1 N at each node of a map, J, shape (n, nodes)."""
    places, energy = places_of(wheels), np.zeros((len(wheels.speed), TOP * FORCES))
    node = (places.speed * FORCES + places.force).astype(int)
    for faster, stronger, way in places.shares(wheels.rolling / GRAVITY):
        energy[np.arange(len(node)), node + faster * FORCES + stronger] = way
    return energy


def some(recorded: RecordedCar, most: int) -> list[list[Interval]]:
    """Drives that are long enough, evenly spread over the log."""
    drives = [d for d in recorded.drives if sum(i.duration for i in d) >= LEAST]
    return [drives[i] for i in np.linspace(0, len(drives) - 1, min(most, len(drives))).astype(int)]


def main(data: str) -> None:
    """Print CRPS, percent of gross energy, of first drives whole and of their 200 s."""
    cars = {key: read_car(data, key.format(data)) for key in CARS}
    energies = {(k, o): whitened(car, o) for k, car in cars.items() for o in (True, False)}
    for key, car in cars.items():
        variants = [Variant("today")]
        for outputs, orthogonal in TRIED:
            others = [energies[other, orthogonal] for other in cars if other != key]
            changes = SharedMap(outputs, others).in_core(orthogonal)
            variants.append(Variant(f"{outputs} maps{'' if orthogonal else ', free'}", changes))
        firsts = [car._replace(drives=[drive]) for drive in some(car, SCORED)]
        for variant in variants:
            rows = [score(variant, first, (0,)) for first in firsts]
            crps = np.mean([(row.carried_crps, row.stretch_crps) for row in rows], axis=0)
            say("{}, {}: {:.2f}, {:.2f}".format(car.key, variant.name, *crps))


if __name__ == "__main__":
    main(sys.argv[1])
