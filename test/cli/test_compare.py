"""`evpinn compare`, and `evpinn replay` of several drives: tables, not a stack of blocks."""

import json

import pytest

CAR = ("--vehicle", "tesla_model_3_lr")


@pytest.fixture(scope="module")
def drives(evpinn, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    for name, load in (("mild", 500), ("cold", 3500)):
        given = ("--duration", 90, "--seed", 3, "--altitude", "--true", f"p_aux={load}")
        assert evpinn("simulate", name, *given, cwd=folder).returncode == 0
    return folder


def test_two_drives_side_by_side(evpinn, drives):
    files = ("--json", "c.json", "--report", "deep/c.html")
    compared = evpinn("compare", "mild", "cold", *CAR, *files, cwd=drives)
    assert compared.returncode == 0, compared.stderr
    assert "cold minus mild" in compared.stdout
    assert "Explained by other standing load (" in compared.stdout
    assert "cold minus mild" in (drives / "deep" / "c.html").read_text()
    document = json.loads((drives / "c.json").read_text())
    assert [drive["name"] for drive in document["drives"]] == ["mild", "cold"]
    (difference,) = document["differences"]
    assert (difference["drive"], difference["less"]) == ("cold", "mild")
    first, other = (
        drive["breakdown"]["measured"]["kwh_per_100km"] for drive in document["drives"]
    )
    assert difference["breakdown"]["measured"]["kwh"] == pytest.approx(other - first)


def test_several_drives_of_a_replay_are_one_table(evpinn, drives):
    ended = evpinn("replay", "mild", "cold", *CAR, "--warm-up", 30, cwd=drives)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("Parameters of the car") == 1
    assert "Where the energy went" not in ended.stdout
    rows = [line.split() for line in ended.stdout.splitlines()]
    mild, cold = (next(row for row in rows if row[:1] == [name]) for name in ("mild", "cold"))
    assert float(cold[2]) > float(mild[2])  # kWh/100 km
