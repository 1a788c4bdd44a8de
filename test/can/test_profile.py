import pytest

from evpinn_ros.can.profile import load_profile, profile_names
from evpinn_ros.can.signal_rule import UnusableError
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from test.can.conftest import refusal

CONFIG = share_directory() / "config" / "can"


def test_every_bundled_profile_loads():
    names = profile_names()
    assert {"nissan_leaf", "tesla_model_3", "tesla_model_3_2019", "tesla_model_s"} <= set(names)
    for name in names:
        profile = load_profile(name)
        assert {"speed", "battery"} & {*profile.messages, *profile.asked}
        assert profile.source and profile.verified_by


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match=r"no CAN profile named 'tesla'; known are bmw_i3,"):
        load_profile("tesla")


def test_a_dbc_file_alone_is_no_profile():
    with pytest.raises(InputError, match=r"my\.dbc: .*; write a profile \(\.yaml\) that names it"):
        load_profile("my.dbc")


def test_missing_file_is_one_line(tmp_path):
    assert refusal(tmp_path / "nowhere.yaml").endswith("nowhere.yaml: No such file or directory")


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("positive_means: charge, ", "", "'positive_means' is missing"),
        ("positive_means: charge", "positive_means: up", "positive_means 'up' is not one of"),
        ("verified_by: >-", "verfied_by: >-", "unknown key 'verfied_by'"),
        ("unit: km/h", "unit: knots", "unit 'knots' is not one of"),
        ("signal: Speed", "signal: Sped", "message 'WheelSpeed' of the DBC file has no signal"),
        ("message: WheelSpeed", "message: Wheel", "the DBC file has no message 'Wheel'"),
        ("valid: [0, 200]", "valid: [200, 0]", "'valid' must be [lowest, highest]"),
        ("valid: [0, 200]", "valid: 200", "must be a list [...] of numbers"),
        ("valid: [0, 200]", "valid: [0, .nan]", "'valid' must be a number"),
        ("  scale: 1.0204", "  scale: 0", "scale = 0 is outside"),
        ("  scale: 1.0204", "  not_available: [1.5]", "whole number"),
        ("  scale: 1.0204", "  not_available: [0x10000]", "65536 is no raw value: 16 bits"),
        # Signed bits that are all ones read as -1, which is a current of no suspicion.
        ("charge, valid:", "charge, not_available: [2047], valid:", "signed, are -1024 to 1023"),
        ("valid: [200, 460]", "valid: [2000, 4600]", "no raw value is within 'valid'"),
        ("positive_means: drive", "positive_means: charge", "is not one of brake, drive"),
        ("torque: {signal", "speeds: {signal", "unknown key 'speeds'"),
        ("motor:  #", "second_motor:  #", "'motor' is missing"),
        ("unit: rpm", "unit: Hz", "unit 'Hz' is not one of rad/s, rpm"),
        ("signal: Torque", "signal: Speed", "overlap in 'MotorState'"),
        ("rule: nissan_crc8", "rule: crc", "rule 'crc' is not one of id_sum, nissan_crc8"),
        ("signal: Checksum}", "signal: Speed}", "'Speed' is not one whole byte"),
        ("dbc: nissan_leaf.dbc", "dbc: other.dbc", "other.dbc: No such file or directory"),
        ("dbc: nissan_leaf.dbc", "dbc: mine.yaml", "not a DBC file"),
    ],
)
def test_wrong_profile_is_refused_with_its_line(broken, old, new, reason):
    assert reason in broken(old, new, "nissan_leaf")


def test_a_raw_value_may_be_hexadecimal(tmp_path):
    text = (CONFIG / "nissan_leaf.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("scale: 1.0204", "not_available: [0xFFFF]"))
    (tmp_path / "nissan_leaf.dbc").write_bytes((CONFIG / "nissan_leaf.dbc").read_bytes())
    rule = load_profile(tmp_path / "mine.yaml").messages["speed"].signals[0]
    with pytest.raises(UnusableError, match="not_available"):
        rule.read(0xFFFF)


def test_source_is_required(broken):
    text = broken('source: "SAE J1979, service 01, identifier 0D"\n', "", "obd2_speed")
    assert "'source' is missing" in text


def test_profile_of_nothing_is_refused(tmp_path):
    (tmp_path / "a.dbc").write_text('VERSION ""\nBU_: X\nBO_ 1 Empty: 8 X\n')
    (tmp_path / "a.yaml").write_text("name: a\nsource: b\nverified_by: c\ndbc: a.dbc\n")
    assert "'speed' or 'battery' is missing" in refusal(tmp_path / "a.yaml")


@pytest.mark.parametrize("text", ["", "- 1\n", "a: [", "? [a]\n: b\n", "a: 1\na: 2\n"])
def test_damaged_yaml_is_one_line(tmp_path, text):
    (tmp_path / "a.yaml").write_text(text)
    refusal(tmp_path / "a.yaml")


def test_endless_nesting_is_one_line(tmp_path):
    (tmp_path / "a.yaml").write_text("[" * 90_000)
    assert refusal(tmp_path / "a.yaml").endswith("a.yaml:1: not YAML: nested too deeply")
