"""The profile that Fast DDS gets from us, where the user has none."""

from __future__ import annotations

import os
from pathlib import Path

from evpinn_ros.common.package_data import share_directory

PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE"
THEIRS = (PROFILES, "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
FOUND_HERE = "DEFAULT_FASTDDS_PROFILES.xml"  # Fast DDS reads it from the working folder


def set_profile() -> None:
    """Have Fast DDS read `config/fastdds.xml`, in this process and its children.

    Each process announces itself every 0.2 s, not 3 s: otherwise nodes that start one after the
    other miss each other in one of three starts. All messages go by UDP, none through shared
    memory, where a killed or starved process can leave others deaf (docs/project/upstream.md).
    Call it before ROS starts; it does not change a user's profiles or other middleware.
    """
    if not any(os.environ.get(their) for their in THEIRS) and not Path(FOUND_HERE).exists():
        os.environ[PROFILES] = str(share_directory() / "config" / "fastdds.xml")
