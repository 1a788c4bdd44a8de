"""The map from an adapter's clock to ours, against a truth that only the test knows."""

from hypothesis import given, settings
from hypothesis import strategies as st

from evpinn_ros.can.bus import LARGEST_DRIFT_PPM, SET_ANEW_NS, ClockMap

NOW = 1_700_000_000 * 10**9
MS = 1_000_000
SECOND = 10**9

steps = st.integers(1, 20 * MS)
delays = st.integers(0, 50 * MS)


def arrivals(frames, drift_ppm, zero=0):
    """Moment of each frame, the adapter's stamp of it, and when it is read: in order, late."""
    moment = read = NOW
    for step, delay in frames:
        moment += step
        read = max(read, moment + delay)  # a late frame holds up those behind it
        device = zero + (moment - NOW) * (1_000_000 + drift_ppm) // 1_000_000
        yield moment, device, read


@given(
    frames=st.lists(st.tuples(steps, delays), min_size=1, max_size=200),
    drift=st.integers(-100, 100),
    zero=st.integers(0, 10**12),
)
@settings(max_examples=60, deadline=None)
def test_stamps_lie_between_moment_and_arrival_and_near_the_best_frame(frames, drift, zero):
    clock, before, earlier = ClockMap(), 0, []
    for moment, device, read in arrivals(frames, drift, zero):
        stamp = clock.convert(device, read)
        late = stamp - moment
        rounding = len(earlier) + 2  # ns: the adapter's whole nanoseconds, our rounding up
        assert -rounding <= late <= read - moment
        assert stamp >= before
        for then, its_delay in earlier:
            slack = 2 * LARGEST_DRIFT_PPM * (moment - then) // 1_000_000 + rounding
            assert late <= its_delay + slack
        earlier.append((moment, read - moment))
        before = stamp


def test_a_minute_of_drift_and_bursts_stays_within_a_fifth_of_a_millisecond():
    # 100 Hz, 100 ppm: 6 ms apart after a minute. USB hands over what it has each 50 ms, so every
    # fifth frame has next to no delay and the others up to 40 ms.
    frames = [(10 * MS, (4 - index % 5) * 10 * MS + MS // 10) for index in range(6000)]
    for drift in (-100, 100):
        clock = ClockMap()
        late = [
            clock.convert(device, read) - moment
            for moment, device, read in arrivals(frames, drift)
        ]
        assert min(late[5:]) >= 0 and max(late[5:]) < 0.2 * MS


def test_a_long_gap_costs_at_most_the_delay_of_the_next_frame():
    clock = ClockMap()
    frames = [(10 * MS, 0), (3600 * SECOND, 30 * MS), (50 * MS, 0), (10 * MS, 20 * MS)]
    late = [clock.convert(device, read) - moment for moment, device, read in arrivals(frames, 100)]
    assert late[1] == 30 * MS and late[2] == 0 and 0 <= late[3] < MS // 100


def test_a_counter_that_begins_again_is_laid_anew():
    clock = ClockMap()
    assert clock.convert(50 * SECOND, NOW) == NOW
    assert clock.convert(50 * SECOND + 10 * MS, NOW + 10 * MS) == NOW + 10 * MS
    assert clock.convert(1 * MS, NOW + 2 * SECOND) == NOW + 2 * SECOND
    assert clock.convert(11 * MS, NOW + 2 * SECOND + 60 * MS) <= NOW + 2 * SECOND + 11 * MS


def test_a_clock_that_is_set_takes_the_stamps_along():
    clock = ClockMap()
    clock.convert(0, NOW)
    forward = NOW + 10 * MS + 2 * SET_ANEW_NS
    assert clock.convert(10 * MS, forward) == forward
    back = forward - 3600 * SECOND
    assert clock.convert(20 * MS, back) == back
    assert 0 <= clock.convert(30 * MS, back + 15 * MS) - (back + 10 * MS) < MS // 100


def test_frames_kept_while_we_slept_are_not_stamped_with_the_awakening():
    """A burst after a stall that is no stall of the clock: each keeps its own moment."""
    clock = ClockMap()
    clock.convert(0, NOW)
    stamps = [clock.convert(i * 10 * MS, NOW + 900 * MS) for i in range(1, 80)]
    assert all(abs(stamp - NOW - i * 10 * MS) <= MS for i, stamp in enumerate(stamps, 1))
