"""Discovery of nodes and planners that start one after the other."""

from __future__ import annotations

import os
from pathlib import Path

from evpinn_ros.common.package_data import share_directory

PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE"
THEIRS = (PROFILES, "FASTRTPS_DEFAULT_PROFILES_FILE")
FOUND_HERE = "DEFAULT_FASTDDS_PROFILES.xml"  # Fast DDS reads it from the working folder


def announce_often() -> None:
    """Have Fast DDS announce this process, and those it starts, every 0.2 s in place of 3 s.

    Nodes that start one after the other otherwise miss each other's announcement every third time
    and wait for the next (docs/project/upstream.md). Call it before ROS starts. Profiles that the
    user has chosen are left as they are; other middleware takes no notice.
    """
    if not any(os.environ.get(name) for name in THEIRS) and not Path(FOUND_HERE).exists():
        os.environ[PROFILES] = str(share_directory() / "config" / "fastdds.xml")
