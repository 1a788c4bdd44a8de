import pytest

from evpinn_ros.can.profile import load_profile, profile_names
from evpinn_ros.can.signal_rule import UnusableError
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


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("verified_by: >-", "verfied_by: >-", "unknown key 'verfied_by'"),
        ("signal: Speed", "signal: Sped", "message 'WheelSpeed' of the DBC file has no signal"),
        ("valid: [0, 200]", "valid: [200, 0]", "'valid' must be [lowest, highest]"),
        ("  scale: 1.0204", "  not_available: [0x10000]", "65536 is no raw value: 16 bits"),
        # Signed bits that are all ones read as -1, which is a current of no suspicion.
        ("charge, valid:", "charge, not_available: [2047], valid:", "signed, are -1024 to 1023"),
        ("valid: [200, 460]", "valid: [2000, 4600]", "no raw value is within 'valid'"),
        ("signal: Torque", "signal: Speed", "overlap in 'MotorState'"),
        ("signal: Checksum}", "signal: Speed}", "'Speed' is not one whole byte"),
        ("dbc: nissan_leaf.dbc", "dbc: other.dbc", "other.dbc: No such file or directory"),
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


@pytest.mark.parametrize("text", ["", "- 1\n", "a: [", "? [a]\n: b\n", "a: 1\na: 2\n"])
def test_damaged_yaml_is_one_line(tmp_path, text):
    (tmp_path / "a.yaml").write_text(text)
    refusal(tmp_path / "a.yaml")


def test_endless_nesting_is_one_line(tmp_path):
    (tmp_path / "a.yaml").write_text("[" * 90_000)
    assert refusal(tmp_path / "a.yaml").endswith("a.yaml:1: not YAML: nested too deeply")
