"""The example of an eco route: what it picks, and that SUMO's model of the car agrees."""

from importlib.util import find_spec

import pytest

from test.conftest import load_example


@pytest.fixture(scope="module")
def example():
    return load_example("routes/eco_route.py")


@pytest.fixture(scope="module")
def ways(example):
    edges = example.roads()
    return edges, *example.ways(edges)


def test_the_cheapest_way_takes_the_pass_and_saves_a_fifth(ways):
    edges, fastest, cheapest, energies = ways
    assert (energies.table.energy_j < 0).any()
    assert cheapest.minutes > fastest.minutes and cheapest.energy < 0.85 * fastest.energy
    climbs = [max(edges.climb_m.to_dict()[road] for road in way.roads) for way in ways[1:3]]
    assert climbs[0] > 30.0 > climbs[1]
    _, sigma = energies.difference(fastest.roads, cheapest.roads)
    assert sigma < 0.8 * fastest.sigma * 3.6e6


@pytest.mark.skipif(not (find_spec("sumo") and find_spec("libsumo")), reason="needs SUMO")
def test_sumos_model_of_the_car_agrees_that_it_is_cheaper(example, ways):
    """By as much as the forecast says, within a sigma; each way within two."""
    edges, fastest, cheapest, energies = ways
    driven = example.sumo_energies(edges, (fastest, cheapest))
    for way, energy in zip((fastest, cheapest), driven, strict=True):
        assert abs(way.energy - energy) < 2.0 * way.sigma
    more, sigma = (joules / 3.6e6 for joules in energies.difference(fastest.roads, cheapest.roads))
    assert driven[0] > 1.15 * driven[1]
    assert abs(driven[0] - driven[1] - more) < sigma
