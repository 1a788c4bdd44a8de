"""`evpinn_ros.core.energy.forecast`: many profiles at once, numpy or torch."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.forecast import Profiles, forecast, forecast_plan
from evpinn_ros.core.energy.plan import plan_from_speed_profile
from evpinn_ros.core.energy.power_model import Weather
from test.core.energy.cars import CAR, COMBINED, SIGMAS, plain, taught

SIMPLE = plain(COMBINED, SIGMAS)
LEARNED = pytest.param("learned", marks=pytest.mark.slow)
MODELS = pytest.mark.parametrize("model", ["combinations", LEARNED], indirect=True)


@pytest.fixture(scope="module")
def model(request):
    """Made when it is wanted, for it takes seconds."""
    return SIMPLE if request.param == "combinations" else taught()


def profiles(seed=0, batch=5, points=60, hills=True):
    rng = np.random.default_rng(seed)
    speed = np.clip(14 + np.cumsum(rng.normal(0, 0.9, (batch, points)), axis=1), 0.5, 38)
    elevation = np.cumsum(rng.normal(0, 0.15, (batch, points)), axis=1)
    return Profiles(np.arange(float(points)), speed, elevation if hills else None)


def energy(driven, model):
    return forecast(driven, CAR, model).energy[0]


@MODELS
def test_a_batch_is_its_plans(model):
    many = profiles(1)
    batch = forecast(many, CAR, model)
    for i, (speed, height) in enumerate(zip(many.speed, many.elevation, strict=True)):
        distance = np.concatenate(([0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)))
        plan = plan_from_speed_profile(many.time, distance, speed, height)
        single = forecast_plan(plan, model, Weather(CAR.air_density))
        # One point in the middle of a leg against three, where the car turns to braking.
        assert batch.energy[i] == pytest.approx(single.energy[-1], rel=0.01)
        assert batch.sigma[i] == pytest.approx(single.sigma[-1], rel=0.01)


@MODELS
def test_chunks_make_no_difference(model):
    many = profiles(2, batch=70)
    batch = forecast(many, CAR, model)
    alone = [forecast(Profiles(many.time, v[None], z[None]), CAR, model)
             for v, z in zip(many.speed, many.elevation, strict=True)]  # fmt: skip
    assert batch.energy == pytest.approx([single.energy[0] for single in alone], rel=1e-12)
    assert batch.sigma == pytest.approx([single.sigma[0] for single in alone], rel=1e-12)


@pytest.mark.slow
@MODELS
def test_torch_gives_the_same_and_its_own_kind(model):
    import torch  # takes seconds

    many = profiles(3)
    batch = forecast(many, CAR, model)
    tensors = forecast(Profiles(*map(torch.as_tensor, many)), CAR, model)
    assert isinstance(batch.energy, np.ndarray) and isinstance(tensors.energy, torch.Tensor)
    assert tensors.energy.numpy() == pytest.approx(batch.energy, rel=1e-10)
    assert tensors.sigma.numpy() == pytest.approx(batch.sigma, rel=1e-10)


@pytest.mark.slow
@MODELS
@pytest.mark.parametrize("name", Profiles._fields)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_gradient_is_that_of_finite_differences(model, name, seed):
    """Away from where power bends or jumps, which a step this small does not cross."""
    import torch  # takes seconds

    many = profiles(seed, batch=2, points=20)
    wanted = getattr(many, name)
    leaves = {field: torch.as_tensor(array) for field, array in many._asdict().items()}
    leaves[name].requires_grad_()
    batch = forecast(Profiles(**leaves), CAR, model)
    (batch.energy.sum() + batch.sigma.sum()).backward()
    gradient = leaves[name].grad.numpy()
    step = 1e-6
    index = tuple(np.random.default_rng(seed).integers(0, wanted.shape))
    ends = []
    for side in (step, -step):
        array = wanted.copy()
        array[index] += side
        at = forecast(Profiles(*map(torch.as_tensor, many._replace(**{name: array}))), CAR, model)
        ends.append(float(at.energy.sum() + at.sigma.sum()))
    difference = (ends[0] - ends[1]) / (2 * step)
    assert gradient[index] == pytest.approx(difference, rel=1e-4, abs=1.0)
