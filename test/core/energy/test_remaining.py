import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import EnergyCurve
from evpinn_ros.core.energy.remaining import (
    FIRST_SPREAD,
    MEMORY,
    MOST_POINTS,
    RECENT,
    USUAL,
    Cost,
    Route,
    cost_spread,
    remaining,
)
from evpinn_ros.core.energy.trip import Stretch

USABLE = Uncertain(60e6, 1e6)
EVEN = Cost(500.0, 500.0, 0.2)
costs = st.floats(200.0, 1500.0)


def test_at_an_even_cost_it_is_energy_over_cost():
    reach = remaining(USABLE, EVEN)
    assert reach.distance == pytest.approx(120e3, abs=1.0)
    assert reach.lower < 0.9 * reach.distance and reach.upper > 1.1 * reach.distance
    assert reach.sigma == pytest.approx((reach.upper - reach.lower) / (2 * 1.6449))


@given(costs, costs, st.floats(1e5, 4e8), st.floats(0.0, 0.3), st.floats(0.0, 0.4))
def test_the_energy_of_the_distance_is_what_is_left(near, long, usable, doubt, spread):
    cost = Cost(near, long, spread)
    reach = remaining(Uncertain(usable, doubt * usable), cost)
    if reach is None:  # so much that its upper end is beyond what is given
        assert usable * (1 + 3 * doubt) > 200.0 * 3e5
        return
    assert 0.0 <= reach.lower <= reach.distance <= reach.upper
    assert cost.energy(reach.distance) == pytest.approx(usable, abs=2 * max(near, long))
    low, high = sorted((near, long))
    assert usable / high - 2.0 <= reach.distance <= usable / low + 2.0


def test_what_is_usual_now_counts_near_and_the_long_run_far():
    cost = Cost.ahead(recent=300.0, long=500.0, usual=1000.0, spread=0.2)
    assert cost == (500.0 + USUAL * 500.0, 500.0, 0.2)
    near = remaining(Uncertain(2e6, 0.0), cost).distance
    far = remaining(Uncertain(300e6, 0.0), cost).distance
    assert near == pytest.approx(2e6 / cost.near, rel=0.06)
    assert far == pytest.approx((300e6 - USUAL * 500.0 * MEMORY) / 500.0, rel=0.02)
    unlearned = Cost.ahead(recent=300.0, long=500.0, usual=math.nan, spread=0.2)
    assert unlearned.near == RECENT * 300.0 + (1.0 - RECENT) * 500.0


@pytest.mark.parametrize(
    ("usable", "cost"),
    [
        (Uncertain(math.nan, math.nan), EVEN),
        (USABLE, Cost(math.nan, 500.0, 0.2)),
        (USABLE, Cost(500.0, -20.0, 0.2)),
        (USABLE, Cost(0.0, 500.0, 0.2)),
        (USABLE, Cost(1.0, 1.0, 0.2)),  # 60 000 km
    ],
)
def test_what_cannot_be_known_is_not_told(usable, cost):
    assert remaining(usable, cost) is None


def test_spread_of_the_cost_goes_from_the_prior_to_the_pieces():
    assert cost_spread([]) == pytest.approx(FIRST_SPREAD)
    even = [Stretch(5e3, 3e6)] * 20
    assert cost_spread(even) == pytest.approx(FIRST_SPREAD * math.sqrt(5 / 25))
    rough = [Stretch(5e3, 1e6), Stretch(5e3, 5e6)] * 10
    assert cost_spread(rough) == pytest.approx(0.6, abs=0.1)


def route(distance, energy, sigma=0.0, begin=0.0):
    """A route by points, in km and MJ; its sigma is a share of the energy."""
    metres, joules = 1e3 * np.array(distance, float), 1e6 * np.array(energy, float)
    columns = metres, joules, sigma * np.abs(joules)
    return Route(*map(tuple, columns), begin, begin_ns=1000, longest_ns=500)


@given(costs, st.floats(5e3, 2e5), st.floats(0.0, 1.0), st.floats(1e6, 2e8))
def test_a_route_of_the_usual_cost_changes_nothing(cost, length, driven, usable):
    even = Cost(cost, cost, 0.0)
    here = Route((0.0, length), (0.0, cost * length), (0.0, 0.0), 7.0, 0, 1000)
    with_it = remaining(Uncertain(usable, 0.0), here.ahead(7.0 + driven * length, even))
    alone = remaining(Uncertain(usable, 0.0), even)
    assert with_it is alone is None or with_it.distance == pytest.approx(alone.distance, abs=3.0)


def test_a_dear_route_shortens_the_way_until_it_is_driven():
    motorway = route([0, 20, 40], [0, 20, 40], sigma=0.1)  # twice the usual 500 J/m
    at_start, half, over = (
        remaining(USABLE, motorway.ahead(1e3 * km, EVEN)).distance for km in (0.0, 20.0, 40.0)
    )
    assert at_start == pytest.approx(40e3 + 20e6 / 500.0, abs=3.0)
    assert half == pytest.approx(20e3 + 40e6 / 500.0, abs=3.0)
    assert over == pytest.approx(120e3, abs=3.0)


def test_who_cannot_cross_the_pass_stops_before_it():
    over_the_pass = route([0, 10, 20], [0, 30, 5])
    reach = remaining(Uncertain(20e6, 0.0), over_the_pass.ahead(0.0, EVEN))
    assert reach.distance == pytest.approx(1e4 * 20 / 30, abs=3.0)
    enough = remaining(Uncertain(31e6, 0.0), over_the_pass.ahead(0.0, EVEN._replace(spread=0.0)))
    assert enough.distance == pytest.approx(20e3 + 26e6 / 500.0, abs=3.0)


def test_the_band_is_that_of_the_route():
    sure, unsure = (
        remaining(USABLE, route([0, 200], [0, 100], sigma).ahead(0.0, EVEN))
        for sigma in (0.01, 0.2)
    )
    assert sure.distance == pytest.approx(unsure.distance) == pytest.approx(120e3, abs=3.0)
    assert unsure.upper - unsure.lower > 5.0 * (sure.upper - sure.lower)


def test_a_route_ends_where_it_was_driven_and_is_given_up_after_a_time():
    some = route([0, 20], [0, 10], begin=5e3)
    assert some.left(5e3, 0) == 20e3 and some.left(24e3, 1500) == 1e3
    assert some.left(25e3, 0) <= 0.0 and some.left(5e3, 1501) == 0.0
    assert some.left(5e3, 999) == 0.0  # time went back to before it


def test_a_route_of_many_points_keeps_some_that_lie_on_it():
    time = np.arange(50_001.0)
    along = 20.0 * time
    energy = 400.0 * along + 1e6 * np.sin(along / 5e3)
    kept = Route.from_here(EnergyCurve(time, along, energy, 0.1 * energy), 7.0, 0)
    assert len(kept.distance) == MOST_POINTS and kept.distance[-1] == along[-1]
    assert kept.cost == pytest.approx(energy[-1] / along[-1])
    assert np.interp(along, kept.distance, kept.energy) == pytest.approx(energy, abs=8e3)
