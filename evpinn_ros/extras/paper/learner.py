"""`mode: paper`: the EV-PINN as published, trained online over a sliding window.

The network has four tanh layers of 128, speed and time in, battery power out. Adam trains it
together with the five parameters, which have their own learning rate, on the loss of eq. 22 with
lambda = 0.1, from the values of eq. 24, 25 (`Vehicle.as_published`), and warm-starts every second.

`PaperOptimizer.GAUSS_NEWTON` minimises the same loss: it solves for the parameters at the measured
power (`paper.log_parameters`) and fits the network to (P + lambda P_physics) / (1 + lambda) by
Levenberg-Marquardt (`paper.gauss_newton`). Choices that the paper leaves open:

- power is normalised by `POWER_SCALE`, speed by `SPEED_SCALE`, time runs from -1 to 0 over the
window; both losses are means over the window in these units;

- acceleration comes from the smoother of `signals.kinematics`;

- P_aux is the median power at standstill (section III.C), else the prior.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.estimation.estimate import ParameterEstimate, ParameterSet, Trust
from evpinn_ros.core.estimation.estimator import EstimatorSettings, PaperOptimizer
from evpinn_ros.core.estimation.learner import Learner, Predictions, Span, gates
from evpinn_ros.core.estimation.parameter_set import UNOBSERVABLE_ABOVE
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import Identifiable, identifiable
from evpinn_ros.core.vehicle.parameters import LIMITS, Parameters
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.gauss_newton import levenberg_marquardt
from evpinn_ros.extras.paper.log_parameters import (
    COMBINATIONS,
    LEARNED,
    LogParameters,
    Physics,
    relative_std,
    standing_load,
)
from evpinn_ros.extras.paper.network import (
    PAPER_WIDTHS,
    PHYSICS_LOSS,
    PowerNetwork,
    paper_adam,
    spread_over_time,
)

WINDOW = 60.0  # s
EPOCHS = 20  # per update, a fixed number, independent of wall time
SPEED_SCALE = 30.0  # m/s
POWER_SCALE = 20_000.0  # W
GAUSS_NEWTON_STEPS = 4  # per update; a window of 600 samples takes about 20 ms for each
FIRST_DAMPING = 1e-2
KINK_SHARPNESS = 0.5  # of the first layer at the start; with 0.1 the loss falls ten times slower
MIN_SAMPLES = 50
NOISE_MEMORY = 300.0  # samples over which the variance of residuals is averaged
FAR = 5.0  # log values above this are impossible


class Window(NamedTuple):
    """Measured samples as columns of shape (n,), arrays or tensors; `age`, s before the newest."""

    age: Any
    speed: Any
    acceleration: Any
    grade: Any
    air_density: Any
    known_auxiliary: Any
    power: Any


class Trained(NamedTuple):
    """Result of an update, from which the next one starts."""

    network: PowerNetwork
    log_scale: torch.Tensor
    optimizer_state: dict[str, Any]
    p_aux: float
    covariance: np.ndarray


WEIGHTS = sum((inputs + 1) * outputs for inputs, outputs in pairwise(PAPER_WIDTHS))


@dataclass(frozen=True, slots=True)
class SavedPaper:
    """Weights in a row, logarithms of learned over initial values, and noise, W^2."""

    SAME = ("regen_form",)

    network: Annotated[np.ndarray, Range(-1e12, 1e12, shape=(WEIGHTS,))]
    log_scale: Annotated[np.ndarray, Range(-FAR, FAR, shape=(len(LEARNED),))]
    p_aux: Annotated[float, Range(-1e6, 1e6)]
    covariance: Annotated[np.ndarray, Range(-1e12, 1e12, shape=(len(LEARNED), len(LEARNED)))]
    variance: Annotated[float, Range(0.0, 1e15)]
    fresh: bool
    regen_form: str

    def __post_init__(self) -> None:
        if not self.variance > 0.0 or np.linalg.eigvalsh(self.covariance)[0] < 0.0:
            raise ValueError("the noise is not positive, or the covariance not positive definite")


class PaperLearner(Saveable[SavedPaper], Learner):
    """Learner of `mode: paper`."""

    learns_samples = True

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        seed: int = 0,
        form: RegenForm = RegenForm.RECOVERY,
        optimizer: PaperOptimizer = PaperOptimizer.ADAM,
    ) -> None:
        """Start at the vehicle's published values with an untrained network."""
        self._vehicle = vehicle = vehicle.as_published
        self._form = form
        self._optimizer = optimizer
        self._parameters = LogParameters(vehicle)
        network = PowerNetwork(PAPER_WIDTHS, seed=seed, dtype=torch.float32)
        if optimizer is PaperOptimizer.GAUSS_NEWTON:
            generator = torch.Generator().manual_seed(seed)
            spread_over_time(network, generator, -1.0, 0.0, KINK_SHARPNESS)
        self._trained = Trained(
            network,
            torch.zeros(len(LEARNED)),
            {},
            vehicle.initial.p_aux,
            np.diag(self._parameters.prior_std**2),
        )
        self._fresh = True
        self._window: deque[tuple[Sample, float]] = deque()
        self._variance = POWER_SCALE**2
        self._last_ns: int | None = None
        self.gated: Counter[str] = Counter()

    def follow(self, span: Span) -> Predictions:
        """Predict each sample of a span by the network trained before it, and learn."""
        count, passed, _ = span.sizes
        newest, smoothed = np.empty((count, 2)), np.empty((passed, 2))
        kinds = (
            (newest, [*span.newest.rows()], span.newest_learned),
            (smoothed, [*span.smoothed.rows()], span.smoothed_learned),
        )
        reasons = gates(span.measured, span.power)
        for learned, sample in enumerate((*span.measured.rows(), None)):
            for predictions, samples, learned_before in kinds:
                for index in np.flatnonzero(learned_before == learned).tolist():
                    predictions[index] = self.predict(samples[index])
            if sample is not None:
                self._observe(sample, float(span.power[learned]), reasons[learned])
        return Predictions(newest, smoothed, np.full((passed, 2), np.nan))

    def predict(self, sample: Sample) -> tuple[float, float]:
        """Power of the network (of the prior until the first update) and its 1-sigma, W."""
        sigma = float(np.sqrt(self._variance))
        if self._fresh:
            return float(self._physics(sample, self._values())), sigma
        newest = self._last_ns if self._last_ns is not None else sample.stamp_ns
        age = max(0.0, (newest - sample.stamp_ns) / NANOSECONDS)
        inputs = torch.tensor([[sample.speed / SPEED_SCALE, -age / WINDOW]])
        with torch.inference_mode():
            output = self._trained.network(inputs)
        return float(output) * POWER_SCALE, sigma

    def _observe(self, sample: Sample, power: float, reason: str | None) -> None:
        if reason is not None:
            self.gated[reason] += 1
            return
        residual = power - self.predict(sample)[0]
        self._variance += (residual**2 - self._variance) / NOISE_MEMORY
        self._window.append((sample, power))
        self._last_ns = sample.stamp_ns
        while self._window[0][0].stamp_ns < sample.stamp_ns - round(WINDOW * NANOSECONDS):
            self._window.popleft()

    def prepare_update(self) -> Callable[[], Trained] | None:
        """A function that trains a copy on a snapshot of the window in a fixed number of steps."""
        if len(self._window) < MIN_SAMPLES or self._last_ns is None:
            return None
        rows = [
            (
                (self._last_ns - sample.stamp_ns) / NANOSECONDS,
                sample.speed,
                sample.acceleration,
                sample.grade,
                sample.air_density,
                sample.known_auxiliary,
                power,
            )
            for sample, power in self._window
        ]
        data, before = Window(*np.array(rows).T), deepcopy(self._trained)
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
        """Parameters with 1-sigma from curvature, priors, and the drift from these."""
        values = self._values()
        variance = np.diag(self._trained.covariance)
        share = np.minimum(1.0, variance / self._parameters.prior_std**2)
        drift = share * self._trained.log_scale.double().numpy()
        relative = np.hypot(np.sqrt(variance), drift)
        estimates = {
            name: ParameterEstimate(
                value=float(np.clip(getattr(values, name), *LIMITS[name])),
                std=float(relative[i] * getattr(values, name)),
                prior_share=float(share[i]),
                lower=LIMITS[name].lower,
                upper=LIMITS[name].upper,
                trust=Trust.UNESTIMATED if share[i] > UNOBSERVABLE_ABOVE else Trust.ESTIMATING,
            )
            for i, name in enumerate(LEARNED)
        }
        prior = self._vehicle.priors["p_aux"]
        estimates["p_aux"] = ParameterEstimate(
            values.p_aux, prior.std, 1.0, *LIMITS["p_aux"], Trust.UNESTIMATED
        )
        combined = identifiable(values, self._vehicle.frontal_area)
        std = {
            name: relative_std(exponents, self._trained.covariance) * getattr(combined, name)
            for name, exponents in COMBINATIONS.items()
        }
        return ParameterSet(
            self._last_ns or 0,
            estimates,
            combined,
            Identifiable(**std, p_aux=prior.std),
            reliable=False,
        )

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time."""
        self._window.clear()
        self._last_ns = None

    def saved(self) -> SavedPaper:
        """State to save: weights, log parameters, noise and standing load."""
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
        """Continue from a saved state, with a new optimizer."""
        network = deepcopy(self._trained.network)
        network.load_vector(torch.tensor(saved.network, dtype=torch.float32))
        log_scale = torch.tensor(saved.log_scale, dtype=torch.float32)
        self._trained = Trained(network, log_scale, {}, saved.p_aux, saved.covariance)
        self._variance, self._fresh = saved.variance, saved.fresh

    def _values(self) -> Parameters:
        return self._parameters.values(self._trained.log_scale, self._trained.p_aux)

    def _physics(self, sample: Sample | Window, values: Parameters) -> Any:
        power = self._vehicle.power(
            sample.speed,
            sample.acceleration,
            values,
            self._form,
            air_density=sample.air_density,
            grade=sample.grade,
        )
        return power + sample.known_auxiliary

    def _train(self, before: Trained, data: Window) -> Trained:
        """One update: P_aux by its definition, other parameters and weights by eq. 22."""
        before = before._replace(
            p_aux=standing_load(data.speed, data.power - data.known_auxiliary, before.p_aux)
        )
        columns = Window(*(torch.tensor(column, dtype=torch.float32) for column in data))
        inputs = torch.stack((columns.speed / SPEED_SCALE, -columns.age / WINDOW), dim=1)

        def physics(log_scale: torch.Tensor) -> torch.Tensor:
            values = self._parameters.tensors(log_scale, before.p_aux)
            power: torch.Tensor = self._physics(columns, values)
            return power

        if self._optimizer is PaperOptimizer.GAUSS_NEWTON:
            return self._gauss_newton(before, physics, columns.power, inputs)
        return self._adam(before, physics, columns.power, inputs)

    def _adam(
        self, before: Trained, physics: Physics, power: torch.Tensor, inputs: torch.Tensor
    ) -> Trained:
        """`EPOCHS` full-batch steps of Adam."""
        network, log_scale = before.network, before.log_scale.requires_grad_()
        optimizer = paper_adam(network, log_scale)
        if before.optimizer_state:
            optimizer.load_state_dict(before.optimizer_state)
        for _ in range(EPOCHS):
            optimizer.zero_grad()
            predicted = network(inputs)
            loss = torch.mean((power / POWER_SCALE - predicted) ** 2)
            expected = physics(log_scale) / POWER_SCALE
            loss = loss + PHYSICS_LOSS * torch.mean((expected - predicted) ** 2)
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
        log_scale = log_scale.detach()
        covariance = self._parameters.covariance(physics, power, log_scale)
        return Trained(network, log_scale, optimizer.state_dict(), before.p_aux, covariance)

    def _gauss_newton(
        self, before: Trained, physics: Physics, power: torch.Tensor, inputs: torch.Tensor
    ) -> Trained:
        """Solve for the parameters of the window, then train for `GAUSS_NEWTON_STEPS`."""
        fit = self._parameters.fit(physics, power, before.log_scale)
        target = (power + PHYSICS_LOSS * physics(fit.log_scale)) / (1.0 + PHYSICS_LOSS)
        damping = levenberg_marquardt(
            before.network,
            inputs,
            target / POWER_SCALE,
            GAUSS_NEWTON_STEPS,
            before.optimizer_state.get("damping", FIRST_DAMPING),
        )
        state = {"damping": damping}
        return Trained(before.network, fit.log_scale, state, before.p_aux, fit.covariance)


def new_learner(vehicle: Vehicle, settings: EstimatorSettings) -> PaperLearner:
    """The learner of `mode: paper`."""
    return PaperLearner(
        vehicle, seed=settings.seed, form=settings.regen_form, optimizer=settings.optimizer
    )
