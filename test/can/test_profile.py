import pytest

from evpinn_ros.can.profile import load_profile, profile_names
from evpinn_ros.can.signal_rule import UnusableError
from evpinn_ros.common.package_data import share_directory

CONFIG = share_directory() / "config" / "can"


def test_every_bundled_profile_loads():
    names = profile_names()
    assert {"nissan_leaf", "tesla_model_3", "tesla_model_3_2019", "tesla_model_s"} <= set(names)
    for name in names:
        profile = load_profile(name)
        assert {"speed", "battery"} & {*profile.messages, *profile.asked}
        assert profile.source and profile.verified_by


WRONG = {
    "nissan_leaf": [
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
    "renault_zoe_ph1": [
        ("read: 22 20 03", "read: 2E 20 03", "must begin with a service that reads: 01, 21, 22"),
        ("read: 22 20 03", "read: 22 20", "takes an identifier of 2 byte(s)"),
        ("read: 22 20 03", "read: 22 32 03", "asks the same as"),
        ("tx: 0x7E4", "tx: 0x18DADAF1", "both have 11 bits or both 29"),
        ("tx: 0x7E4", "tx: 0x7EC", "'rx' must differ from 'tx'"),
        ("tx: 0x7E4", "tx: 0x7DF", "share only the answer id"),
        ("tx: 0x7E4", "tx: 0x7E5", "0x7EC is no answer id of 0x7E5"),
        ("tx: 0x7E4", "tx: 0x000", "0x0 is no diagnostic id (ISO 15765-4, or on the list in"),
        ("tx: 0x7E4", "tx: 0x1D4", "0x1D4 is no diagnostic id"),
        ("tx: 0x7E4, rx: 0x7EC", "tx: 0x18DA7E4, rx: 0x18DA7EC", "is no diagnostic id"),
        ("tx: 0x7E4", "tx: 0x6F1", "0x7EC is no answer id of 0x6F1"),
        ("tx: 0x7E4, rx: 0x7EC", "tx: 0x6F1, rx: 0x607", "0x6F1 needs a 'target'"),
        ("rx: 0x7EC", "rx: 0x7EC, target: 7, source: 0xF1", "takes no 'target'"),
        ("2, period: 5", "2, period: 0.05", "35 requests a second; at most 25"),
        ("rx: 0x7EC", "rx: 0x3FFFFFFF", "rx is outside"),
        ("rx: 0x7EC", "rx: 0x7EC, target: 7", "needs both 'target' and 'source'"),
        ("min_length: 2", "min_length: 1", "ends behind min_length = 1 of request 'speed'"),
        ("period: 0.2", "period: 0.001", "period = 0.001 is outside"),
        ("  voltage: {request: voltage,", "  voltage: {request: current,", "voltage and current"),
        ("speed: {request: speed,", "speed: {message: A,", "no quantity needs request 'speed'"),
    ],
}


@pytest.mark.parametrize(
    ("name", "old", "new", "reason"),
    [(name, *change) for name, changes in WRONG.items() for change in changes],
)
def test_a_wrong_profile_is_refused_with_its_line(broken, name, old, new, reason):
    assert reason in broken(old, new, name)


def test_a_raw_value_may_be_hexadecimal(tmp_path):
    text = (CONFIG / "nissan_leaf.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("scale: 1.0204", "not_available: [0xFFFF]"))
    (tmp_path / "nissan_leaf.dbc").write_bytes((CONFIG / "nissan_leaf.dbc").read_bytes())
    rule = load_profile(tmp_path / "mine.yaml").messages["speed"].signals[0]
    with pytest.raises(UnusableError, match="not_available"):
        rule.read(0xFFFF)
