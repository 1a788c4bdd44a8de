"""Processes that start find each other soon, and what users have set for Fast DDS stays."""

import os
from pathlib import Path
import sys

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.discovery import PROFILES, USER_FILE, USER_SETTINGS, set_profile
from evpinn_ros.nodes.processes import own_network
from test.nodes.processes import started


@pytest.fixture
def nothing_set(monkeypatch, tmp_path):
    for name in USER_SETTINGS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    return monkeypatch


def test_fast_dds_gets_our_profile(nothing_set):
    set_profile()
    path = Path(os.environ[PROFILES])
    assert path.name == "fastdds.xml" and path.is_file()


@pytest.mark.parametrize("name", USER_SETTINGS)
def test_a_profile_of_the_user_stays(nothing_set, name):
    nothing_set.setenv(name, "mine.xml")
    set_profile()
    assert os.environ[name] == "mine.xml"
    assert os.environ.get(PROFILES, "mine.xml") == "mine.xml"


def test_a_profile_in_the_working_folder_stays(nothing_set):
    Path(USER_FILE).touch()
    set_profile()
    assert PROFILES not in os.environ


def test_nobody_gets_the_domain_of_nodes_that_were_left_behind(monkeypatch):
    monkeypatch.setattr(os, "environ", dict(os.environ))
    first = 10 * os.getpid()  # of no other run of this test, for which the second stays taken
    left = {**os.environ, "ROS_DOMAIN_ID": f"{first}"}
    with started(sys.executable, "-c", "input()", env=left, stdin=-1):
        with pytest.raises(InputError, match=f"no ROS domain of {first} to {first} is free"):
            own_network(range(first, first + 1))
        own_network(range(first, first + 2))
        assert os.environ["ROS_DOMAIN_ID"] == f"{first + 1}"
