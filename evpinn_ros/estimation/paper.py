"""`mode: paper`: the EV-PINN as published, trained online over a sliding window.

Four layers of 128 with tanh, speed and time in, battery power out; the five parameters trained
together with the network by Adam at a learning rate of their own; the loss of eq. 22 with
lambda = 0.1; initial values of eq. 24, 25 (`Vehicle.as_published`). Once a second the network and
Adam's memory are taken up where they were (warm start) and trained a fixed number of epochs on
the window.

`PaperOptimizer.GAUSS_NEWTON` minimises the same loss over the same network and window. As for any
power the best parameters are a small least-squares problem (priors hold what no data determine),
it solves for them at the measured power, where the minimum of eq. 22 has them if the network can
follow, and brings the network to (P + lambda P_physics) / (1 + lambda) by Levenberg-Marquardt in
the space of residuals (`estimation.gauss_newton`). What the paper leaves open is settled so:

- power is normalised by `POWER_SCALE`, speed by `SPEED_SCALE`, time runs from -1 to 0 over the
  window; both losses are means over the window in these units;
- each parameter is its initial value times exp(z), with z trained: it stays positive, and one
  learning rate serves all;
- acceleration, which eq. 21 needs, comes from the smoother of `signals.kinematics`;
- P_aux is no free parameter: the median power at standstill (section III.C), else the prior.

The network knows neither acceleration nor the future. Its predictions are what the paper's method
gives on unseen moments, and worse than on those it was trained on; `hybrid` repairs that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
import torch

from evpinn_ros.common.saved_fields import SAME, Range, Saveable
from evpinn_ros.estimation.estimate import ParameterEstimate, ParameterSet, Trust
from evpinn_ros.estimation.evidence import NO_EVIDENCE, Evidence
from evpinn_ros.estimation.gauss_newton import levenberg_marquardt
from evpinn_ros.estimation.learner import LearnerReport, PowerPrediction, gate
from evpinn_ros.estimation.network import PAPER_WIDTHS, PowerNetwork, spread_over_time
from evpinn_ros.estimation.paper_optimizer import PaperOptimizer
from evpinn_ros.estimation.parameter_set import UNOBSERVABLE_ABOVE
from evpinn_ros.estimation.window import Batch, Observation, SlidingWindow, batch
from evpinn_ros.signals.interval import Interval
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import IDENTIFIABLE_NAMES, Identifiable, identifiable
from evpinn_ros.vehicle.parameters import LIMITS, Parameters
from evpinn_ros.vehicle.physics import (
    RegenForm,
    auxiliary_power,
    battery_power,
)

LEARNED = ("eta", "mu", "mass", "c_rr", "c_d")
WINDOW = 60.0  # s
EPOCHS = 20  # per update, a fixed budget: never one of wall time
PHYSICS_LOSS = 0.1  # lambda of eq. 22
NETWORK_RATE = 1e-3  # Adam
PARAMETER_RATE = 2e-3  # Adam, of log values
SPEED_SCALE = 30.0  # m/s
POWER_SCALE = 20_000.0  # W
GAUSS_NEWTON_STEPS = 4  # per update; a window of 600 samples takes about 20 ms for each
FIRST_DAMPING = 1e-2
KINK_SHARPNESS = 0.5  # of the first layer's start; with 0.1 the loss falls ten times slower
FIT_ITERATIONS = 10
CONVERGED = 1e-4  # of log values
LONGEST_STEP = 0.5  # of log values: further, the linearisation no longer holds
MIN_SAMPLES = 50
NOISE_MEMORY = 300.0  # samples over which the size of the residuals is followed
FAR = 5.0  # log values beyond this are no car's
LEAST_NOISE = 60.0  # W, 1-sigma of the residuals, however well the window fits
CORRELATED_SAMPLES = 5.0  # samples of a 10 Hz stream that count as one


class Tensors(NamedTuple):
    """A `Batch` as tensors."""

    age: torch.Tensor
    speed: torch.Tensor
    acceleration: torch.Tensor
    grade: torch.Tensor
    air_density: torch.Tensor
    known_auxiliary: torch.Tensor
    power: torch.Tensor
    head_wind: torch.Tensor


class Trained(NamedTuple):
    """Result of an update: all that the next one starts from."""

    network: PowerNetwork
    log_scale: torch.Tensor
    optimizer_state: dict[str, Any]
    p_aux: float
    covariance: np.ndarray


Weights: TypeAlias = Annotated[np.ndarray, Range(-1e12, 1e12)]


@dataclass(frozen=True, slots=True)
class SavedPaper:
    """Weights in a row, logarithms of the learned over their initial values, and noise, W^2."""

    network: Weights
    log_scale: Annotated[np.ndarray, Range(-FAR, FAR)]
    p_aux: Annotated[float, Range(-1e6, 1e6)]
    covariance: Weights
    variance: Annotated[float, Range(0.0, 1e15)]
    fresh: bool
    regen_form: Annotated[str, SAME]

    def __post_init__(self) -> None:
        """Refuse noise and a covariance that are none."""
        if not self.variance > 0.0 or np.linalg.eigvalsh(self.covariance)[0] < 0.0:
            raise ValueError("the noise or the covariance is none")


class PaperLearner(Saveable[SavedPaper]):
    """See the module's text."""

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        seed: int = 0,
        form: RegenForm = RegenForm.RECOVERY,
        optimizer: PaperOptimizer = PaperOptimizer.ADAM,
    ) -> None:
        """Start at the vehicle's published values with a fresh network."""
        self._vehicle = vehicle = vehicle.as_published
        self._form = form
        self._optimizer = optimizer
        self._prior_std = np.array(
            [vehicle.priors[n].std / vehicle.priors[n].value for n in LEARNED]
        )
        network = PowerNetwork(PAPER_WIDTHS, seed=seed, dtype=torch.float32)
        if optimizer is PaperOptimizer.GAUSS_NEWTON:
            generator = torch.Generator().manual_seed(seed)
            spread_over_time(network, generator, -1.0, 0.0, KINK_SHARPNESS)
        self._trained = Trained(
            network,
            torch.zeros(len(LEARNED)),
            {},
            vehicle.initial.p_aux,
            np.diag(self._prior_std**2),
        )
        self._fresh = True
        self._window = SlidingWindow(WINDOW)
        self._variance = POWER_SCALE**2
        self._last_ns: int | None = None
        self.gated: Counter[str] = Counter()

    def advance(self, sample: Sample) -> None:
        """Nothing moves between updates."""

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power of the network, W: the prior's physics until the first update."""
        sigma = float(np.sqrt(self._variance))
        if self._fresh:
            power = float(self._physics(sample)) + sample.known_auxiliary
            return PowerPrediction(power, sigma)
        newest = self._last_ns if self._last_ns is not None else sample.stamp_ns
        age = max(0.0, (newest - sample.stamp_ns) / NANOSECONDS)
        inputs = torch.tensor([[sample.speed / SPEED_SCALE, -age / WINDOW]])
        with torch.inference_mode():
            output = self._trained.network(inputs)
        return PowerPrediction(float(output) * POWER_SCALE, sigma)

    def observe(self, sample: Sample, power: float) -> None:
        """Take a measured sample into the window."""
        reason = gate(sample, power)
        if reason is not None:
            self.gated[reason] += 1
            return
        residual = power - self.predict(sample).power
        self._variance += (residual**2 - self._variance) / NOISE_MEMORY
        self._window.add(Observation(sample, power))
        self._last_ns = sample.stamp_ns

    def add_interval(self, interval: Interval) -> bool:
        """Nothing: the paper learns from samples."""
        return False

    def evidence(self) -> Evidence:
        """Nothing that a population could use: no prior holds the paper's parameters."""
        return NO_EVIDENCE

    def prepare_update(self) -> Callable[[], Trained] | None:
        """Train a copy on a snapshot of the window, by a fixed number of steps."""
        if len(self._window) < MIN_SAMPLES or self._last_ns is None:
            return None
        data = batch(list(self._window), self._last_ns)
        before = deepcopy(self._trained)
        return lambda: self._train(before, data)

    def consider(self, candidate: Trained) -> str | None:
        """Accept every finite update, as the paper does."""
        if not (
            torch.isfinite(candidate.network.vector()).all()
            and torch.isfinite(candidate.log_scale).all()
        ):
            return "not_finite"
        self._trained = candidate
        self._fresh = False
        return None

    def parameters(self) -> ParameterSet:
        """Present estimate, its 1-sigma from the curvature of the physics loss and the priors.

        No prior holds the paper's parameters: without data, Adam lets them drift.
        So what lies off the prior without the data's support counts as error too.
        """
        values = self._values(self._trained)
        variance = np.diag(self._trained.covariance)
        share = np.minimum(1.0, variance / self._prior_std**2)
        drift = share * self._trained.log_scale.double().numpy()
        relative_std = np.hypot(np.sqrt(variance), drift)
        estimates = {
            name: ParameterEstimate(
                value=float(np.clip(getattr(values, name), *LIMITS[name])),
                std=float(relative_std[i] * getattr(values, name)),
                prior_share=float(share[i]),
                lower=LIMITS[name].lower,
                upper=LIMITS[name].upper,
                state=Trust.UNESTIMATED if share[i] > UNOBSERVABLE_ABOVE else Trust.ESTIMATING,
            )
            for i, name in enumerate(LEARNED)
        }
        prior = self._vehicle.priors["p_aux"]
        estimates["p_aux"] = ParameterEstimate(
            values.p_aux, prior.std, 1.0, *LIMITS["p_aux"], Trust.UNESTIMATED
        )
        combined = identifiable(values, self._vehicle.frontal_area)
        std = _combined_std(combined, self._trained.covariance, prior.std)
        return ParameterSet(self._last_ns or 0, estimates, combined, std, reliable=False)

    def breakdowns(self) -> None:
        """None: eq. 21 alone does not tell losses and loads apart."""

    def linear_power(self, celsius: float | None) -> None:
        """Nothing: the network that predicts knows no speed that was not driven."""

    def report(self) -> LearnerReport:
        """Nothing: the paper's mode does not look for changes of the car."""
        return LearnerReport()

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time."""
        self._window.clear()
        self._last_ns = None

    def end_drive(self) -> None:
        """Nothing here is of one drive alone."""

    def saved(self) -> SavedPaper:
        """State to save."""
        return SavedPaper(
            network=self._trained.network.vector().detach().numpy(),
            log_scale=self._trained.log_scale.detach().numpy(),
            p_aux=self._trained.p_aux,
            covariance=self._trained.covariance,
            variance=self._variance,
            fresh=self._fresh,
            regen_form=self._form.value,
        )

    def take(self, saved: SavedPaper) -> None:
        """Go on from a saved state; the optimizer's memory starts anew."""
        network = deepcopy(self._trained.network)
        network.load_vector(torch.tensor(saved.network, dtype=torch.float32))
        log_scale = torch.tensor(saved.log_scale, dtype=torch.float32)
        self._trained = Trained(network, log_scale, {}, saved.p_aux, saved.covariance)
        self._variance, self._fresh = saved.variance, saved.fresh

    def _values(self, trained: Trained) -> Parameters:
        scale = np.exp(trained.log_scale.double().numpy())
        initial = self._vehicle.initial
        learned = [float(getattr(initial, n) * scale[i]) for i, n in enumerate(LEARNED)]
        return Parameters._make([*learned, trained.p_aux])

    def _physics(self, sample: Sample | Tensors, values: Parameters | None = None) -> Any:
        """Battery power of eq. 21, W, at the present or given values."""
        return battery_power(
            sample.speed,
            sample.acceleration,
            self._values(self._trained) if values is None else values,
            area=self._vehicle.frontal_area,
            air_density=sample.air_density,
            form=self._form,
            beta=self._vehicle.beta,
            grade=sample.grade,
        )

    def _train(self, before: Trained, data: Batch) -> Trained:
        """One update: P_aux by its definition, the rest by eq. 22."""
        standing = auxiliary_power(data.speed, data.power - data.known_auxiliary)
        p_aux = before.p_aux if np.isnan(standing) else max(standing, LIMITS["p_aux"].lower)
        columns = Tensors._make(torch.tensor(column, dtype=torch.float32) for column in data)
        inputs = torch.stack((columns.speed / SPEED_SCALE, -columns.age / WINDOW), dim=1)
        before = before._replace(p_aux=p_aux)
        if self._optimizer is PaperOptimizer.GAUSS_NEWTON:
            return self._gauss_newton(before, columns, inputs)
        return self._adam(before, columns, inputs)

    def _adam(self, before: Trained, columns: Tensors, inputs: torch.Tensor) -> Trained:
        """`EPOCHS` full-batch steps of Adam."""
        network, log_scale = before.network, before.log_scale.requires_grad_()
        optimizer = torch.optim.Adam(
            [
                {"params": network.parameters(), "lr": NETWORK_RATE},
                {"params": [log_scale], "lr": PARAMETER_RATE},
            ]
        )
        if before.optimizer_state:
            optimizer.load_state_dict(before.optimizer_state)
        for _ in range(EPOCHS):
            optimizer.zero_grad()
            predicted = network(inputs)
            physics = self._learned_physics(columns, log_scale, before.p_aux) / POWER_SCALE
            loss = torch.mean((columns.power / POWER_SCALE - predicted) ** 2)
            loss = loss + PHYSICS_LOSS * torch.mean((physics - predicted) ** 2)
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
        log_scale = log_scale.detach()
        covariance = np.linalg.inv(self._curvature(columns, log_scale, before.p_aux)[0])
        return Trained(network, log_scale, optimizer.state_dict(), before.p_aux, covariance)

    def _gauss_newton(self, before: Trained, columns: Tensors, inputs: torch.Tensor) -> Trained:
        """The parameters that fit the window, and `GAUSS_NEWTON_STEPS` of the network."""
        log_scale, p_aux = self._fitted(columns, before.log_scale, before.p_aux), before.p_aux
        physics = self._learned_physics(columns, log_scale, p_aux)
        target = (columns.power + PHYSICS_LOSS * physics) / ((1.0 + PHYSICS_LOSS) * POWER_SCALE)
        damping = levenberg_marquardt(
            before.network,
            inputs,
            target,
            GAUSS_NEWTON_STEPS,
            before.optimizer_state.get("damping", FIRST_DAMPING),
        )
        covariance = np.linalg.inv(self._curvature(columns, log_scale, p_aux)[0])
        return Trained(before.network, log_scale, {"damping": damping}, p_aux, covariance)

    def _fitted(self, data: Tensors, log_scale: torch.Tensor, p_aux: float) -> torch.Tensor:
        """The log parameters with which eq. 21 fits measured power and priors best, shape (5,)."""
        for _ in range(FIT_ITERATIONS):
            curvature, slope = self._curvature(data, log_scale, p_aux)
            step = np.linalg.solve(curvature, slope)
            longest = float(np.abs(step).max())
            step *= min(1.0, LONGEST_STEP / max(longest, CONVERGED))
            log_scale = log_scale + torch.as_tensor(step, dtype=log_scale.dtype)
            if longest < CONVERGED:
                break
        return log_scale

    def _learned_physics(
        self, data: Tensors, log_scale: torch.Tensor, p_aux: float
    ) -> torch.Tensor:
        initial = torch.tensor([getattr(self._vehicle.initial, n) for n in LEARNED])
        values = Parameters._make([*(initial * torch.exp(log_scale)), p_aux])
        power: torch.Tensor = self._physics(data, values) + data.known_auxiliary
        return power

    def _curvature(
        self, data: Tensors, log_scale: torch.Tensor, p_aux: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations of the log parameters, data and priors: shape (5, 5) and (5,).

        The inverse of the first is Laplace's approximation of their covariance.
        """
        gradient = torch.func.jacfwd(lambda z: self._learned_physics(data, z, p_aux))(log_scale)
        residual = data.power - self._learned_physics(data, log_scale, p_aux)
        noise = max(float(torch.mean(residual**2)), LEAST_NOISE**2) * CORRELATED_SAMPLES
        rows, left = gradient.double().numpy(), residual.detach().double().numpy()
        precision = self._prior_std**-2
        slope = rows.T @ left / noise - precision * log_scale.double().numpy()
        return rows.T @ rows / noise + np.diag(precision), slope


def _combined_std(
    combined: Identifiable, covariance: np.ndarray, p_aux_std: float
) -> Identifiable:
    """1-sigma of the identifiable combinations from the covariance of the log parameters."""
    rows = {
        "mass_over_eta": {"mass": 1.0, "eta": -1.0},
        "drag_area_over_eta": {"c_d": 1.0, "eta": -1.0},
        "c_rr": {"c_rr": 1.0},
        "regeneration": {"eta": 1.0, "mu": 1.0},
    }
    std = {"p_aux": p_aux_std}
    for name, row in rows.items():
        vector = np.array([row.get(parameter, 0.0) for parameter in LEARNED])
        std[name] = float(np.sqrt(vector @ covariance @ vector)) * getattr(combined, name)
    return Identifiable(*(std[name] for name in IDENTIFIABLE_NAMES))
