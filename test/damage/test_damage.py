"""Damaged inputs for every parser: each is read or refused in one line."""

from random import Random

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import pytest

from test.damage.targets import TARGETS

pytestmark = pytest.mark.nightly

EXAMPLES = 25
NAMES = [target.name for target in TARGETS]


@st.composite
def damage(draw, seeds):
    """A sound input with bytes changed, cut out, said twice, or its end missing."""
    data = bytearray(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(1, 8))):
        at = draw(st.integers(0, len(data)))
        end = at + draw(st.integers(0, 16))
        change = draw(st.sampled_from(("write", "remove", "repeat", "insert", "cut")))
        if change == "write":
            data[at:end] = draw(st.binary(min_size=1, max_size=16))
        elif change == "remove":
            del data[at:end]
        elif change == "repeat":
            data[at:at] = data[at:end] * draw(st.integers(1, 4))
        elif change == "insert":
            data[at:at] = draw(st.text(max_size=12)).encode()
        else:
            del data[at:]
    return bytes(data)


@pytest.fixture(scope="module", params=TARGETS, ids=NAMES)
def target(request):
    return request.param


@pytest.fixture(scope="module")
def seeds(target):
    return target.seeds()


@pytest.fixture(scope="module")
def folder(target, tmp_path_factory):
    made = tmp_path_factory.mktemp("target")
    target.beside(made)
    return made


def test_a_seed_is_sound(target, seeds, folder):
    """Else the fuzzer would never come behind the first check."""
    for seed in seeds:
        path = folder / target.file_name
        path.write_bytes(seed)
        target.parse(path)


@given(data=st.data())
@settings(
    max_examples=EXAMPLES,
    suppress_health_check=[*HealthCheck],
)
def test_damage_is_refused_in_one_line(target, seeds, folder, data):
    target.run(folder, data.draw(damage(seeds)))


@pytest.mark.parametrize(
    "target", [target for target in TARGETS if target.mutate], ids=lambda t: t.name, indirect=True
)
@given(seed=st.integers(0, 2**32), turns=st.integers(1, 3))
@settings(max_examples=EXAMPLES, suppress_health_check=[*HealthCheck])
def test_damage_that_keeps_the_structure_is_refused_in_one_line(
    target, seeds, folder, seed, turns
):
    chance = Random(seed)
    data = chance.choice(seeds)
    for _ in range(turns):
        data = target.mutate(data, chance)
    target.run(folder, data)
