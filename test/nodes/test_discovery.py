"""Processes that start find each other soon, and what users have set for Fast DDS stays."""

import os
from pathlib import Path

import pytest

from evpinn_ros.nodes.discovery import FOUND_HERE, PROFILES, THEIRS, announce_often


@pytest.fixture
def nothing_set(monkeypatch, tmp_path):
    for name in THEIRS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    return monkeypatch


def test_fast_dds_gets_our_profile(nothing_set):
    announce_often()
    path = Path(os.environ[PROFILES])
    assert path.name == "fastdds.xml" and path.is_file()


@pytest.mark.parametrize("name", THEIRS)
def test_a_profile_of_the_user_stays(nothing_set, name):
    nothing_set.setenv(name, "mine.xml")
    announce_often()
    assert os.environ[name] == "mine.xml"
    assert os.environ.get(PROFILES, "mine.xml") == "mine.xml"


def test_a_profile_in_the_working_folder_stays(nothing_set):
    Path(FOUND_HERE).touch()
    announce_often()
    assert PROFILES not in os.environ
