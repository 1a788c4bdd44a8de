"""What a bag says of a topic, by every storage and reader."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos

RawMessage: TypeAlias = tuple[int, int, bytes]  # log time, ns; channel id; data
LONGEST_QOS = 100_000  # characters; a topic of a hundred publishers has a third of it
QosProfiles: TypeAlias = "tuple[Qos, ...] | None"


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of a file, the type of its messages, and how they are encoded."""

    topic: str
    type_name: str
    encoding: str
    definition: str = ""  # of the type; empty where the file has none
    type_hash: str = ""
    qos: QosProfiles = ()  # that its publishers offered, None where it cannot be read


def plain_qos(text: str) -> bool:
    """True for QoS as recorders write it: short, and without YAML's names of values."""
    return len(text) <= LONGEST_QOS and not set("&*<") & set(text)


def parsed_qos(text: object) -> QosProfiles:
    """Profiles in the YAML of a recorder, None if that cannot be read."""
    if not isinstance(text, str) or not plain_qos(text):
        return None
    try:
        return tuple(parse_qos(text))
    except Exception:  # of a library: what a damaged text raises is listed nowhere
        return None
