import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.estimation.estimator import PaperOptimizer
from evpinn_ros.core.estimation.learner import Span
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import NO_NS, NO_SAMPLES, Sample, Samples
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES, Parameters
from evpinn_ros.core.vehicle.physics import RegenForm, battery_power
from evpinn_ros.extras.paper.learner import POWER_SCALE, PaperLearner
from evpinn_ros.extras.paper.log_parameters import LEARNED
from evpinn_ros.extras.paper.network import PHYSICS_LOSS

TRUTH = Parameters(eta=0.85, mu=0.78, mass=1960.0, c_rr=0.0105, c_d=0.235, p_aux=1250.0)


def predict(learner: PaperLearner, sample: Sample) -> float:
    """Power at a smoothed sample, W."""
    return learner.predict(sample)[0]


def observe(learner: PaperLearner, sample: Sample, power: float) -> None:
    """Let it learn from a measured sample."""
    measured, nothing, place = Samples.of([sample]), NO_NS, np.zeros(1, np.int64)
    columns = NO_SAMPLES, nothing, nothing, NO_SAMPLES, measured, np.array([power]), place
    learner.follow(Span(*columns, nothing))


def teach(learner, drive, first=0, last=None):
    pairs = list(zip(drive.samples, drive.powers, strict=True))
    for sample, power in pairs[first:last]:
        observe(learner, sample, power)
    return learner


def train(learner, updates):
    for _ in range(updates):
        assert learner.consider(learner.prepare_update()()) is None
    return learner


def loss(learner, drive, first, last):
    """Data and physics loss of eq. 22 over the window, worked out sample by sample."""
    data = physics = 0.0
    pairs = list(zip(drive.samples, drive.powers, strict=True))[first:last]
    for sample, power in pairs:
        said = predict(learner, sample) / POWER_SCALE
        by_physics = float(learner._physics(sample, learner._values())) / POWER_SCALE
        data += (power / POWER_SCALE - said) ** 2 / len(pairs)
        physics += (by_physics - said) ** 2 / len(pairs)
    return data, physics


def test_it_starts_where_the_paper_does():
    """Not at the priors of the vehicle file (eq. 24)."""
    car = load_vehicle("tesla_model_3_lr")
    estimates = PaperLearner(car).parameters().parameters
    assert tuple(estimates[name].value for name in LEARNED) == (0.7, 0.5, 1823.0, 0.0096, 0.23)
    assert estimates["mass"].value != car.initial.mass


def test_before_the_first_update_it_says_what_the_physics_says(vehicle):
    learner = PaperLearner(vehicle)
    sample = Sample(0, 15.0, -1.0, 0.0, 1.17, 200.0)
    power = battery_power(
        15.0,
        -1.0,
        vehicle.initial,
        area=vehicle.frontal_area,
        air_density=1.17,
        form=RegenForm.RECOVERY,
        beta=vehicle.beta,
    )
    assert predict(learner, sample) == pytest.approx(power + 200.0)
    estimates = learner.parameters()
    assert [estimates.parameters[n].value for n in PARAMETER_NAMES] == pytest.approx(
        vehicle.initial
    )
    assert {p.trust for p in estimates.parameters.values()} == {Trust.UNESTIMATED}


def test_p_aux_is_the_median_at_standstill_less_known_loads(vehicle):
    learner = PaperLearner(vehicle)
    for k in range(100):
        sample = Sample(k * NANOSECONDS // 10, 0.0, 0.0, 0.0, 1.17, 400.0)
        observe(learner, sample, 1500.0 + (k % 3 - 1) * 50.0)
    train(learner, 1)
    assert learner.parameters().parameters["p_aux"].value == pytest.approx(1100.0)


def test_what_is_published_is_within_its_limits(vehicle, synthetic):
    """A car that gives twice the power: eta is driven up; what is published stays possible."""
    drive = synthetic(TRUTH._replace(eta=1.0, p_aux=300.0))
    learner = train(teach(PaperLearner(vehicle), drive, 100, 200), 15)
    estimates = learner.parameters().parameters
    for name, estimate in estimates.items():
        assert LIMITS[name].lower <= estimate.value <= LIMITS[name].upper
        assert estimate.std > 0 and 0 <= estimate.prior_share <= 1
    assert estimates["eta"].value > vehicle.initial.eta


def test_sigma_is_told_by_data_and_prior(vehicle, synthetic):
    learner = train(teach(PaperLearner(vehicle), synthetic(TRUTH), 100, 400), 1)
    estimates = learner.parameters()
    for name in LEARNED:
        prior = vehicle.priors[name]
        estimate = estimates.parameters[name]
        relative = estimate.std / estimate.value
        # What drifted off the prior without the data's support is error as well.
        drift = abs(math.log(estimate.value / prior.value))
        assert relative <= math.hypot(prior.std / prior.value, drift) * (1 + 1e-6)
        assert relative >= estimate.prior_share * drift
    relative = estimates.identifiable_std.mass_over_eta / estimates.identifiable.mass_over_eta
    assert relative < 0.5 * math.hypot(110 / 1823, 0.1 / 0.7)


def test_reverse_and_charging_teach_nothing(vehicle):
    learner = PaperLearner(vehicle)
    observe(learner, Sample(0, -0.2, 0.0, 0.0, 1.17, 0.0), 1000.0)
    observe(learner, Sample(1, 0.0, 0.0, 0.0, 1.17, 0.0), -3000.0)
    assert learner.gated == {"reverse": 1, "charging": 1}
    assert learner.prepare_update() is None


def test_an_update_that_is_not_finite_is_refused(vehicle, synthetic):
    learner = teach(PaperLearner(vehicle), synthetic(TRUTH), 100, 400)
    candidate = learner.prepare_update()()
    before = learner.export()
    for wrong in (
        candidate._replace(log_scale=candidate.log_scale * math.nan),
        candidate._replace(network=learner.prepare_update()().network),
    ):
        if wrong.log_scale.isfinite().all():
            wrong.network.load_vector(wrong.network.vector() * math.inf)
        assert learner.consider(wrong) == "not_finite"
    assert learner.export() == before


def test_gauss_newton_comes_nearer_to_the_least_loss_and_finds_the_parameters(vehicle, synthetic):
    drive, losses = synthetic(TRUTH, hills=0.0), {}
    for optimizer in PaperOptimizer:
        form = RegenForm.WHEEL_POWER  # the car's
        learner = teach(PaperLearner(vehicle, form=form, optimizer=optimizer), drive, 300, 600)
        train(learner, 4)
        data, physics = loss(learner, drive, 300, 600)
        losses[optimizer] = data + PHYSICS_LOSS * physics
        estimates = learner.parameters()
    assert losses[PaperOptimizer.GAUSS_NEWTON] < 0.1 * losses[PaperOptimizer.ADAM], losses
    # The car obeys eq. 21, so the window alone tells what it tells.
    assert estimates.identifiable.mass_over_eta == pytest.approx(1960 / 0.85, rel=0.05)
    assert estimates.identifiable.regeneration == pytest.approx(0.85 * 0.78, rel=0.1)


def test_gauss_newton_gives_the_same_bits_and_survives_a_round_trip(vehicle, synthetic):
    drive = synthetic(TRUTH)

    def learner():
        return PaperLearner(vehicle, optimizer=PaperOptimizer.GAUSS_NEWTON)

    first, second = (train(teach(learner(), drive, 100, 400), 2) for _ in range(2))
    assert first.export() == second.export()
    other = learner()
    other.restore(first.export())
    assert predict(other, drive.samples[-1]) == predict(first, drive.samples[-1])
