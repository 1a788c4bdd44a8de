"""Checksums of car makers, by the name a profile gives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

ChecksumRule = Callable[[int, bytes], int]
"""From the frame's id and its bytes without the checksum byte to that byte."""


def id_sum(can_id: int, payload: bytes) -> int:
    """Sum of both bytes of the id and of the payload, modulo 256 (Tesla; Nissan 0x284)."""
    return ((can_id & 0xFF) + (can_id >> 8) + sum(payload)) & 0xFF


def nissan_crc8(_can_id: int, payload: bytes) -> int:
    """CRC-8 with polynomial 0x85, start 0, most significant bit first (Nissan 0x1DB)."""
    crc = 0
    for byte in payload:
        crc = _CRC8_TABLE[crc ^ byte]
    return crc


def _crc8_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1) ^ (0x185 if byte & 0x80 else 0)
    return byte


_CRC8_TABLE = bytes(_crc8_of_byte(byte) for byte in range(256))

CHECKSUM_RULES: Mapping[str, ChecksumRule] = {"id_sum": id_sum, "nissan_crc8": nissan_crc8}
