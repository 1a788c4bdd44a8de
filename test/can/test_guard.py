"""The guard: a right profile is never refused, a wrong one never lets out a wrong number."""

import random

import pytest

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard, ProfileVerdict
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import ALL, KONA, PROFILES

SECOND = 10**9


def guarded(name, **kwargs):
    profile = PROFILES[name]
    guard = FitGuard(profile, ALL, **kwargs)
    return guard, CanBridge(profile, guard=guard)


def run(bridge, frames):
    readings = [reading for frame in frames for reading in bridge.decode(frame)]
    return [*readings, *bridge.finish()]


def decoded(name, frames):
    return decoded_by(PROFILES[name], frames)


def decoded_by(profile, frames):
    decoder = Decoder(profile)
    return [reading for frame in frames for reading in decoder.decode(frame)]


@pytest.mark.parametrize("patient", [False, True])
@pytest.mark.parametrize("name", sorted(PROFILES))
def test_a_right_profile_loses_nothing(name, patient, bus):
    frames = bus(name)
    guard, bridge = guarded(name, patient=patient)
    assert repr(run(bridge, frames)) == repr(decoded(name, frames))
    assert guard.verdict is ProfileVerdict.TRUSTED and not guard.dropped


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_a_right_profile_speaks_within_a_second(name, bus):
    _, bridge = guarded(name)
    frames = bus(name)
    first = next(frame for frame in frames if bridge.decode(frame))
    assert first.stamp_ns - frames[0].stamp_ns < SECOND


@pytest.mark.parametrize(
    ("name", "quantity"),
    [
        (name, quantity)
        for name in sorted(PROFILES)
        for quantity in ("speed", "battery")
        if quantity in PROFILES[name].messages
    ],
)
def test_a_log_filtered_to_one_id_is_no_contradiction(name, quantity, bus):
    wanted = PROFILES[name].messages[quantity].message.frame_id
    frames = [frame for frame in bus(name) if frame.can_id == wanted]
    guard, bridge = guarded(name)
    assert repr(run(bridge, frames)) == repr(decoded(name, frames))
    assert guard.verdict is ProfileVerdict.TRUSTED


@pytest.mark.parametrize("wrong", sorted(PROFILES))
@pytest.mark.parametrize("right", sorted(PROFILES))
def test_no_profile_lets_out_what_another_car_did_not_say(right, wrong, bus):
    """Where cars share a layout one profile reads the other's bus; then the numbers agree."""
    truth = {(type(r), r.stamp_ns): r for r in decoded(right, bus(right))}
    _, bridge = guarded(wrong)
    for reading in run(bridge, bus(right)):
        true = truth[type(reading), reading.stamp_ns]
        if isinstance(reading, SpeedReading):
            assert reading.speed == pytest.approx(true.speed, rel=0.03, abs=0.05)
        else:
            assert reading.voltage == pytest.approx(true.voltage, abs=1.0)
            assert reading.current == pytest.approx(true.current, abs=1.0)


@pytest.mark.parametrize("patient", [False, True])
def test_the_firmware_of_another_year(patient, bus):
    guard, bridge = guarded("tesla_model_3", patient=patient)
    for reading in run(bridge, bus("tesla_model_3_2019")):
        assert isinstance(reading, SpeedReading)
    assert guard.verdict is ProfileVerdict.REFUSED
    assert guard.contradiction.better == "tesla_model_3_2019"
    assert "battery (0x132): 100 % out_of_range" in bridge.refusal


def test_an_adapter_moved_to_another_car_and_back(bus):
    """What contradicts later is stopped within seconds, and what comes right goes on."""
    guard, bridge = guarded("tesla_model_3")
    right, wrong = bus("tesla_model_3")[:300], bus("tesla_model_3_2019")[300:600]
    again = bus("tesla_model_3")[600:]
    assert len(run(bridge, right)) == len(decoded("tesla_model_3", right))
    batteries = [r for r in run(bridge, wrong) if isinstance(r, BatteryReading)]
    assert not batteries and guard.verdict is ProfileVerdict.REFUSED
    back = run(bridge, again)
    assert guard.verdict is ProfileVerdict.TRUSTED and bridge.refusal is None
    assert back[0].stamp_ns - again[0].stamp_ns < 25 * SECOND
    assert back[-1].stamp_ns == again[-1].stamp_ns


def test_a_battery_that_is_off_is_no_contradiction(bus):
    """Zero volts are out of range; the speed's checksums prove the car."""
    zero = bytes(8)
    frames = [
        CanFrame(f.stamp_ns, f.can_id, zero) if f.can_id == 0x132 else f
        for f in bus("tesla_model_3")
    ]
    guard, bridge = guarded("tesla_model_3")
    readings = run(bridge, frames)
    assert guard.verdict is ProfileVerdict.TRUSTED
    assert readings and repr(readings) == repr(decoded("tesla_model_3", frames))


USER_DBC = """VERSION ""

BU_: X

BO_ 80 Mine: 8 X
 SG_ Speed : 0|16@1+ (0.01,0) [0|600] "km/h" X
 SG_ Volt : 16|16@1+ (0.1,0) [0|600] "V" X
 SG_ Amp : 32|16@1- (0.1,0) [0|600] "A" X
"""
USER_PROFILE = """name: mine
source: measured
verified_by: nothing
dbc: mine.dbc
speed: {message: Mine, signal: Speed, unit: km/h, valid: [0, 200]}
battery:
  message: Mine
  voltage: {signal: Volt, unit: V, valid: [200, 500]}
  current: {signal: Amp, unit: A, positive_means: charge, valid: [-500, 500]}
"""


@pytest.fixture
def mine(tmp_path):
    (tmp_path / "mine.dbc").write_text(USER_DBC)
    (tmp_path / "mine.yaml").write_text(USER_PROFILE)
    return load_profile(tmp_path / "mine.yaml")


def test_noise_under_a_profile_without_checksums_is_refused_before_it_speaks(mine):
    """Ten a second: the first half second holds too little to judge by, so the guard waits."""
    for seed in range(20):
        chance = random.Random(seed)
        guard = FitGuard(mine, ALL)
        bridge = CanBridge(mine, guard=guard)
        frames = [CanFrame(i * SECOND // 10, 80, chance.randbytes(8)) for i in range(300)]
        assert decoded_by(mine, frames) and run(bridge, frames) == []
        assert guard.verdict is ProfileVerdict.REFUSED and guard.contradiction.better is None


def test_a_car_that_stands_still_and_never_changes_is_accepted(mine):
    encoder = Encoder(mine)
    frame = encoder.battery(BatteryReading(0, 380.0, -1.0))
    frames = [CanFrame(i * SECOND // 10, 80, frame.data) for i in range(20)]
    guard = FitGuard(mine, ALL)
    assert len(run(CanBridge(mine, guard=guard), frames)) == 40


def test_a_silent_profile_is_told_who_would_fit(bus):
    _, bridge = guarded("nissan_leaf")
    assert run(bridge, bus("tesla_model_s")) == []
    text = bridge.status(0).text
    assert "no frame" in text and "'tesla_model_s' fits" in text


def test_stamps_that_stand_still_or_go_back_do_not_hold_for_ever(bus):
    frames = bus("tesla_model_3")
    still = [CanFrame(7, f.can_id, f.data) for f in frames]
    _, bridge = guarded("tesla_model_3")
    assert len(run(bridge, still)) == len(decoded("tesla_model_3", still))
    guard, bridge = guarded("tesla_model_3")
    looped = [*frames, *frames]
    assert len(run(bridge, looped)) == len(decoded("tesla_model_3", looped))
    assert guard.verdict is ProfileVerdict.TRUSTED


def test_answers_need_no_weighing():
    """A profile that asks has no broadcast to be judged by; an answer echoes its question."""
    kona = load_profile("hyundai_kia")
    bridge = CanBridge(kona, guard=FitGuard(kona, ALL))
    frames = [CanFrame(i, 0x7EC, bytes.fromhex(data)) for i, data in enumerate(KONA.split())]
    (reading,) = run(bridge, frames)
    assert isinstance(reading, BatteryReading)
    assert bridge.status(10).text == "no speed" and bridge.refusal is None
