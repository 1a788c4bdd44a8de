"""The metadata.yaml of a rosbag2 folder, version 9 (Jazzy)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import yaml

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.writer import write_file
from evpinn_ros.common.yaml_section import load_plain
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.topics import SPEED, topic_of

METADATA = "metadata.yaml"
INFORMATION = "rosbag2_bagfile_information"
VERSION = 9
MOST_METADATA = 1_000_000  # bytes; 500 topics take half of it
FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(slots=True)
class WrittenTopic:
    """A topic of a bag that is being written, with the QoS of its publisher."""

    name: str
    type_name: str
    type_hash: str
    qos: list[dict[str, Any]]
    count: int = 0


@dataclass(slots=True)
class WrittenFile:
    """A file of a bag that is being written: message count, first and last log time, ns."""

    name: str
    count: int = 0
    start_ns: int = 0
    end_ns: int = 0

    def add(self, log_time_ns: int) -> None:
        """Count a message, and widen the span of log times to it."""
        self.start_ns = min(self.start_ns, log_time_ns) if self.count else log_time_ns
        self.end_ns = max(self.end_ns, log_time_ns) if self.count else log_time_ns
        self.count += 1


def qos_profiles(topic_name: str) -> list[dict[str, Any]]:
    """QoS of a topic's publisher in rosbag2's form; unknown topics are reliable, depth 10."""
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
    files: Sequence[WrittenFile], topics: Iterable[WrittenTopic]
) -> dict[str, Any]:
    """Content of metadata.yaml for a bag of MCAP files."""
    filled = [file for file in files if file.count] or files[:1]
    start_ns = min(file.start_ns for file in filled)
    end_ns = max(file.end_ns for file in filled)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span(start_ns, end_ns, sum(file.count for file in files)),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": topic.qos,
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {"path": file.name, **_span(file.start_ns, file.end_ns, file.count)} for file in files
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _span(start_ns: int, end_ns: int, count: int) -> dict[str, Any]:
    return {
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": count,
    }


def as_yaml(content: Any) -> str:
    """YAML as rosbag2 writes it: one key a line, in the given order, without references."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False)


def write_metadata(folder: Path, information: dict[str, Any]) -> None:
    """Replace metadata.yaml atomically: a kill leaves the old or the new file."""
    write_file(folder / METADATA, as_yaml({INFORMATION: information}))


class _Dumper(yaml.SafeDumper):
    """Writes repeated values in full: readers of rosbag2 expect no YAML references."""

    def ignore_aliases(self, data: Any) -> bool:
        """Always True: no value becomes a reference."""
        return True


def stated_seconds(bag: Path) -> float | None:
    """Duration of a bag by its metadata.yaml, s; None if missing or invalid."""
    try:
        document = load_plain(bag / METADATA, "metadata", MOST_METADATA)
        seconds = float(document[INFORMATION]["duration"]["nanoseconds"]) / NANOSECONDS
    except (InputError, KeyError, TypeError, ValueError, OverflowError):
        return None
    return seconds if 0 < seconds < math.inf else None
