"""Description of a topic of a bag, the same for every storage and reader."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos

RawMessage: TypeAlias = tuple[int, int, bytes]  # log time, ns; channel id; data
LONGEST_QOS = 100_000  # characters; 100 publishers of a topic take a third of it
QosProfiles: TypeAlias = "tuple[Qos, ...] | None"


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of a file, the type of its messages, and how they are encoded."""

    topic: str
    type_name: str
    encoding: str
    definition: str = ""  # of the type; empty if the file has none
    type_hash: str = ""
    qos: QosProfiles = ()  # offered by its publishers; None if unreadable


def plain_qos(text: str) -> bool:
    """True for QoS as recorders write it: short, and without YAML anchors, aliases or merges."""
    return len(text) <= LONGEST_QOS and not set("&*<") & set(text)


def parsed_qos(text: object) -> QosProfiles:
    """QoS profiles in the YAML of a recorder; None if unreadable."""
    if not isinstance(text, str) or not plain_qos(text):
        return None
    try:
        return tuple(parse_qos(text))
    except Exception:  # the library documents no exceptions for damaged text
        return None
