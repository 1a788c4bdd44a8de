"""The metadata.yaml of a rosbag2 folder, version 9 (Jazzy)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from evpinn_ros.nodes.topics import SPEED, topic_of

METADATA = "metadata.yaml"
INFORMATION = "rosbag2_bagfile_information"
VERSION = 9
FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(slots=True)
class WrittenTopic:
    """A topic of a bag that is being written."""

    name: str
    type_name: str
    type_hash: str
    channel_id: int
    count: int = 0


def qos_profiles(topic_name: str) -> list[dict[str, Any]]:
    """What the publisher of a topic offers, in the form of rosbag2.

    A topic that is not of this package gets the default: reliable, ten deep.
    """
    qos = (topic_of(topic_name) or SPEED).publisher_qos
    return [
        {
            "history": "keep_last",
            "depth": qos.depth,
            "reliability": "reliable" if qos.reliable else "best_effort",
            "durability": "transient_local" if qos.transient_local else "volatile",
            "deadline": dict(FOREVER),
            "lifespan": dict(FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(FOREVER),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def bag_information(
    file_name: str, topics: Iterable[WrittenTopic], start_ns: int, end_ns: int
) -> dict[str, Any]:
    """What metadata.yaml says of a bag of one MCAP file, from its first to its last log time."""
    topics = list(topics)
    span: dict[str, Any] = {
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(topic.count for topic in topics),
    }
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **span,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos_profiles(topic.name),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [{"path": file_name, **span}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def as_yaml(content: Any) -> str:
    """YAML as rosbag2 writes it: one key a line, in the given order, without references."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False)


def write_metadata(folder: Path, information: dict[str, Any]) -> None:
    """Replace metadata.yaml at one stroke: a kill leaves the old or the new one."""
    draft = folder / f"{METADATA}.tmp"
    draft.write_text(as_yaml({INFORMATION: information}), encoding="utf-8")
    draft.replace(folder / METADATA)


class _Dumper(yaml.SafeDumper):
    """Writes what occurs twice twice: readers of rosbag2 expect no YAML references."""

    def ignore_aliases(self, data: Any) -> bool:
        """Always."""
        return True
