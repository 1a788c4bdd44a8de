"""The only CAN ids to which requests may go, each with the source that documents it.

Any other id may belong to a control unit: a frame of ours there could claim, in its name, that the
brake is pressed or the airbag fired. A new diagnostic id is added here, with its source, in a
reviewed change; profiles cannot add ids.
"""

from __future__ import annotations

from collections.abc import Mapping

LAST_11_BIT_ID = 0x7FF
TESTER = 0xF1
"""Address of a diagnostic tester, in ISO 15765-4 and at BMW."""

FUNCTIONAL = frozenset({0x7DF, 0x18DB33F1})
"""Ids that every control unit receives; flow control must not use them (ISO 15765-4)."""

BMW_GATEWAY = 0x6F1
"""The id whose frames name the control unit in their first byte (extended addressing)."""


def _pairs(requests: range, first_answer: int) -> Mapping[int, range]:
    """Answer id of each request id; both count up together."""
    answers = range(first_answer, first_answer + requests.step * len(requests), requests.step)
    return {tx: range(rx, rx + 1) for tx, rx in zip(requests, answers, strict=True)}


REQUEST_IDS: Mapping[str, Mapping[int, range]] = {
    "ISO 15765-4, 11 bit, to one control unit": _pairs(range(0x7E0, 0x7E8), 0x7E8),
    "ISO 15765-4, 11 bit, to all": {0x7DF: range(0x7E8, 0x7F0)},
    "ISO 15765-4, 29 bit, to one control unit": {
        0x18DA00F1 | unit << 8: range(0x18DAF100 | unit, 0x18DAF100 | unit + 1)
        for unit in range(0x100)
    },
    "ISO 15765-4, 29 bit, to all": {0x18DB33F1: range(0x18DAF100, 0x18DAF200)},
    "Hyundai, Kia (openvehicles/Open-Vehicle-Monitoring-System-3, vehicle_kianiroev and "
    "vehicle_hyundai_ioniq5)": {
        tx: range(tx + 8, tx + 9) for tx in (0x770, 0x7A0, 0x7B3, 0x7C6, 0x7D1)
    },
    "Nissan, Renault (openvehicles/Open-Vehicle-Monitoring-System-3, vehicle_nissanleaf and "
    "vehicle_renaulttwizy)": {
        0x743: range(0x763, 0x764),
        0x797: range(0x79A, 0x79B),
        0x79B: range(0x7BB, 0x7BC),
    },
    "BMW (openvehicles/Open-Vehicle-Monitoring-System-3, vehicle_bmwi3)": {
        BMW_GATEWAY: range(0x600, 0x700)
    },
    "Volkswagen (meatpiHQ/wican-fw, vw; iternio/ev-obd-pids, volkswagen/MEB)": _pairs(
        range(0x17FC0000, 0x17FC0100), 0x17FE0000
    ),
}
"""By source: request ids, and the ids from which each may be answered."""

_ANSWERS = {tx: rx for pairs in REQUEST_IDS.values() for tx, rx in pairs.items()}


def is_request_id(can_id: int, extended: bool) -> bool:
    """True if only testers, and no control unit, send on this id."""
    return can_id in _ANSWERS and extended == (can_id > LAST_11_BIT_ID)


def refusal(tx_id: int, rx_id: int, target: int | None, source: int | None) -> str | None:
    """Why a control unit may not be asked, or None; `target`, `source` are first bytes."""
    if tx_id not in _ANSWERS:
        return (
            f"0x{tx_id:X} is no diagnostic id (ISO 15765-4, or on the list in "
            "docs/explanation/can.md)"
        )
    if rx_id not in _ANSWERS[tx_id]:
        return f"0x{rx_id:X} is no answer id of 0x{tx_id:X}"
    if tx_id != BMW_GATEWAY:
        return None if target is None else f"0x{tx_id:X} takes no 'target' and 'source'"
    if target is None or source != TESTER or rx_id != 0x600 + target:
        return "0x6F1 needs a 'target', 'rx' 0x600 + target, and 'source' 0xF1"
    return None
