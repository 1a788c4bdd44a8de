"""Messages that were lost, stamps that leap: told from what arrives."""

import pytest

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.arrivals import MOST_PUBLISHERS, MessageNumbers, StampWatch
from evpinn_ros.nodes.diagnosis import LATELY, Lately


def info(number, publisher=b"a"):
    gid = {"publisher_gid": {"data": publisher}} if publisher else {}
    return {"publication_sequence_number": number, **gid}


def test_a_gap_in_the_numbers_of_a_publisher_is_what_was_lost():
    for name in (b"a", None):  # None as in Jazzy
        numbers = MessageNumbers()
        lost = [numbers.record("speed", info(n, name), 0.0).lost for n in (301, 302, 305, 306)]
        assert lost == [0, 0, 2, 0]
        assert numbers.record("battery", info(900, name), 0.0).lost == 0
        assert numbers.record("speed", info(1, name and b"b"), 0.0).lost == 0


def test_a_middleware_that_tells_no_numbers_counts_nothing_and_excludes_nothing():
    numbers = MessageNumbers()
    assert (
        numbers.record("speed", {}, 0.0) == numbers.record("speed", info(None), 0.0) == (0, True)
    )


def test_publishers_that_come_and_go_for_years_are_not_kept():
    numbers = MessageNumbers()
    for publisher in range(1000):
        numbers.record("speed", info(1, publisher.to_bytes(4, "big")), 0.0)
    assert len(numbers._numbers["speed"]) <= MOST_PUBLISHERS


@pytest.mark.parametrize("names", [(b"a", b"b"), (None, None)])
def test_two_publishers_are_told_from_one_that_was_started_anew(names):
    def recorded(*messages):
        numbers = MessageNumbers()
        return [
            numbers.record("speed", info(n, names[who]), step / 10)
            for step, (who, n) in enumerate(messages)
        ]

    anew = recorded((0, 301), (0, 302), (1, 1), (1, 2), (1, 3))
    assert set(anew) == {(0, False)}
    two = recorded((0, 301), (1, 1), (0, 302), (1, 2), (0, 303))
    assert [arrival.by_turns for arrival in two] == [False, False, False, True, False]
    assert recorded((0, 7), (1, 7), (0, 8), (1, 8))[-1].by_turns  # both began at once
    assert {arrival.lost for arrival in two} == {0}


def watch(*moments):
    """Verdicts on (stamp, now, steady), in seconds."""
    guard = StampWatch()
    return [
        guard.check(round(stamp * NANOSECONDS), round(now * NANOSECONDS), steady)
        for stamp, now, steady in moments
    ]


def test_stamps_of_the_future_and_leaps_are_told_and_silence_is_not():
    assert watch((100, 100, 1), (100.1, 100.1, 1.1), (900, 900, 800)) == [None] * 3
    assert "ahead of this computer's clock" in watch((3700, 100, 1))[0]
    assert watch((100, 100, 1), (3700, 3700, 1.1))[1] == "stamps jumped ahead by 3600 s"


def test_old_stamps_are_those_of_a_replay():
    assert watch((100, 1e9, 1), (101, 1e9, 1.1), (102, 1e9, 1.2)) == [None] * 3


def test_what_happened_lately_is_forgotten():
    lately = Lately()
    assert lately.update(0.0, {"late": 5}) == {"late": 5}
    assert lately.update(LATELY / 2, {"late": 7}) == {"late": 7}
    assert lately.update(LATELY + 1, {"late": 7}) == {"late": 2}
    assert lately.update(2 * LATELY, {"late": 7}) == {}
