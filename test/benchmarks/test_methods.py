"""Peers that learn nothing, and which peers a car has."""

import math

import pytest

from benchmarks.methods import PEERS, PriorOnly, PublishedParameters, peers
from evpinn_ros.estimation.states import PHYSICS, State
from evpinn_ros.estimation.terms import Equation, Warmth
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import load_vehicle
from evpinn_ros.vehicle.physics import RegenForm

BRAKING = Sample(1, 12.0, -1.0, 0.0, 1.17, 0.0)


def test_prior_is_the_equation_of_the_learner_at_the_vehicle_file(vehicle, samples):
    """Without the losses that no vehicle file names."""
    equation, prior = Equation(vehicle), PriorOnly(vehicle)
    named = [*PHYSICS, State.P_AUX, State.REPORTED]
    for sample in samples[::300]:
        found = equation.row_of(sample, Warmth(0.0, 0.0))[named] @ equation.mean[named]
        # cos(grade) of the rolling resistance is 1 there, which is a watt or two.
        assert prior.predict(sample).power == pytest.approx(found, abs=3.0)


def test_nothing_moves_those_that_learn_nothing(vehicle, samples):
    for method in (PriorOnly(vehicle), PublishedParameters(vehicle, RegenForm.PRINTED)):
        before = method.predict(samples[0])
        method.observe(samples[0], 1e5)
        assert method.predict(samples[0]).power == before.power
        assert math.isnan(before.sigma)


@pytest.mark.parametrize(("form", "share"), [("recovery", 0.6743), ("printed", 1 - 0.6743)])
def test_table_v_by_hand(vehicle, form, share):
    # Eq. 21 with A = 2.22 m^2: drag, rolling, and what the form leaves of the inertia.
    drag = 0.5 * 1.17 * 2.22 * 0.2349 * 12.0**3
    rolling = 0.00915 * 1975 * 9.80665 * 12.0
    wanted = (drag + rolling - share * 1975 * 12.0) / 0.7349 + 1100.0
    method = PublishedParameters(vehicle, RegenForm(form))
    assert method.predict(BRAKING).power == pytest.approx(wanted)


def test_table_v_is_of_two_cars(vehicle):
    assert set(peers(list(PEERS), vehicle)) == set(PEERS)
    others = set(peers(list(PEERS), load_vehicle("bmw_i3")))
    assert others == {name for name in PEERS if not name.startswith("table5")}
    assert "table5_printed" in peers(list(PEERS), load_vehicle("tesla_model_s"))


def test_only_what_was_chosen_runs(vehicle):
    assert list(peers(["ekf5", "null", "hybrid", "prior"], vehicle)) == ["ekf5", "prior"]
