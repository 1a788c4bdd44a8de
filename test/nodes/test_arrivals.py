"""Messages that were lost, stamps that leap: told from what arrives."""

from evpinn_ros.nodes.arrivals import MOST_PUBLISHERS, Losses, StampWatch
from evpinn_ros.nodes.diagnosis import LATELY, Lately, unused_notice
from evpinn_ros.signals.readings import NANOSECONDS


def info(number, publisher=b"a"):
    return {"publication_sequence_number": number, "publisher_gid": {"data": publisher}}


def test_a_gap_in_the_numbers_of_a_publisher_is_what_was_lost():
    losses = Losses()
    assert [losses.push("speed", info(n)) for n in (301, 302, 305, 306)] == [0, 0, 2, 0]
    assert losses.push("battery", info(900)) == losses.push("speed", info(1, b"b")) == 0


def test_a_middleware_that_tells_no_numbers_counts_nothing():
    losses = Losses()
    assert losses.push("speed", {}) == losses.push("speed", info(None)) == 0
    assert losses.push("speed", {"publication_sequence_number": 9}) == 0


def test_publishers_that_come_and_go_for_years_are_not_kept():
    losses = Losses()
    for publisher in range(1000):
        losses.push("speed", info(1, publisher.to_bytes(4, "big")))
    assert len(losses._numbers["speed"]) <= MOST_PUBLISHERS


def watch(*moments):
    """Verdicts on (stamp, now, steady), in seconds."""
    guard = StampWatch()
    return [
        guard.push(round(stamp * NANOSECONDS), round(now * NANOSECONDS), steady)
        for stamp, now, steady in moments
    ]


def test_stamps_of_the_future_and_leaps_are_told_and_silence_is_not():
    assert watch((100, 100, 1), (100.1, 100.1, 1.1), (900, 900, 800)) == [None] * 3
    assert "ahead of this computer's clock" in watch((3700, 100, 1))[0]
    assert watch((100, 100, 1), (3700, 3700, 1.1))[1] == "stamps leapt ahead by 3600 s"


def test_old_stamps_are_those_of_a_replay():
    assert watch((100, 1e9, 1), (101, 1e9, 1.1), (102, 1e9, 1.2)) == [None] * 3


def test_a_clock_that_is_not_known_yet_judges_nothing():
    assert watch((100, 0, 1)) == [None]


def test_what_happened_lately_is_forgotten():
    lately = Lately()
    assert lately.push(0.0, {"late": 5}) == {"late": 5}
    assert lately.push(LATELY / 2, {"late": 7}) == {"late": 7}
    assert lately.push(LATELY + 1, {"late": 7}) == {"late": 2}
    assert lately.push(2 * LATELY, {"late": 7}) == {}


def test_a_few_messages_lost_are_no_news():
    assert unused_notice({"speed_late": 3}) is None
    assert unused_notice({"b": 3, "a": 1}) == "not used lately: a 1, b 3"
