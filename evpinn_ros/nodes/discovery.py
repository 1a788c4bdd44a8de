"""Sets this package's profile of Fast DDS, unless the user has one."""

from __future__ import annotations

import os
from pathlib import Path

from evpinn_ros.common.package_data import share_directory

PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE"
USER_SETTINGS = (PROFILES, "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
USER_FILE = "DEFAULT_FASTDDS_PROFILES.xml"  # Fast DDS reads it from the working folder


def set_profile() -> None:
    """Have Fast DDS read `config/fastdds.xml`, in this process and its children.

    Each process announces itself every 0.2 s, not 3 s: otherwise nodes that start one after the
    other miss each other in one of three starts. All messages go by UDP, none through shared
    memory, where a killed or starved process can keep others from receiving
    (docs/project/upstream.md). Call it before ROS starts. It does not replace a user's profile.
    """
    if not any(map(os.environ.get, USER_SETTINGS)) and not Path(USER_FILE).exists():
        os.environ[PROFILES] = str(share_directory() / "config" / "fastdds.xml")
