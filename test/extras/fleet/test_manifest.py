"""Which drives are of which car."""

import os

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.fleet.manifest import cars_by_folder, cars_by_manifest

LEAF = load_vehicle("nissan_leaf")


@pytest.fixture
def data(empty_files):
    """Bags, loose bag files and CSV files of three cars."""
    return empty_files(
        "data/ann/2025/monday/monday_0.mcap",
        "data/ann/2025/tuesday/metadata.yaml",
        "data/ann/2025/tuesday/part.mcap",
        "data/bob/first.mcap",
        "data/bob/second.mcap",
        "data/bob/notes.txt",
        "data/loose.csv",
        "other/bob/third.mcap",
    )


def names_of(cars, data):
    return {car.car: [str(path.relative_to(data)) for path in car.drives] for car in cars}


ALL = {
    "ann": ["data/ann/2025/monday", "data/ann/2025/tuesday"],
    "bob": ["data/bob/first.mcap", "data/bob/second.mcap"],
    "data": ["data/loose.csv"],
}


def test_a_top_folder_is_a_car(data):
    assert names_of(cars_by_folder([str(data / "data")], LEAF), data) == ALL


def test_packed_files_of_a_killed_recorder_are_drives(empty_files):
    data = empty_files("data/ann/day/day_0.mcap.zstd", "data/ann/loose.db3.zstd")
    found = names_of(cars_by_folder([str(data / "data")], LEAF), data)
    assert found == {"ann": ["data/ann/day", "data/ann/loose.db3.zstd"]}


def test_two_folders_of_one_name_are_not_mixed(data):
    with pytest.raises(InputError, match="would both be car 'bob'"):
        cars_by_folder([str(data / "data"), str(data / "other")], LEAF)


@pytest.mark.timeout(20)
def test_links_of_folders_count_no_drive_twice(data):
    """Two links to the folder around them would be a tree of 2 ** 40 folders."""
    top = data / "data"
    for folder in (top, top / "ann", top / "bob"):
        for name in ("a", "b"):
            (folder / name).symlink_to(".")
    (top / "ann" / "of_bob").symlink_to("../bob")
    (top / "ann" / "again.mcap").symlink_to("../bob/first.mcap")
    (top / "ann" / "circle.csv").symlink_to("circle.csv")
    (top / "ann" / "nowhere.csv").symlink_to("not_there.csv")
    broken = ["data/ann/circle.csv", "data/ann/nowhere.csv"]  # cost themselves alone, later
    names = names_of(cars_by_folder([str(top)], LEAF), data)
    everything = sorted(drive for drives in names.values() for drive in drives)
    assert everything == sorted([*broken, *(drive for drives in ALL.values() for drive in drives)])
    assert [drive for drive in names["ann"] if drive not in broken] == ALL["ann"]


def test_a_link_keeps_the_name_that_tells_the_format(data):
    """Stores such as git-annex link names to files that are named by their content."""
    (data / "store").mkdir()
    (data / "store" / "d3b07384").write_bytes(b"t_s\n")
    (data / "data" / "bob" / "third.csv").symlink_to("../../store/d3b07384")
    names = names_of(cars_by_folder([str(data / "data")], LEAF), data)
    assert names["bob"] == [*ALL["bob"], "data/bob/third.csv"]


def test_a_drive_of_two_names_has_one_car(data):
    (data / "data" / "ann" / "again.mcap").symlink_to("../bob/first.mcap")
    text = "drive,car,vehicle\ndata/bob,bob,nissan_leaf\ndata/ann/again.mcap,{},nissan_leaf\n"
    (data / "cars.csv").write_text(text.format("bob"))
    assert names_of(cars_by_manifest(data / "cars.csv"), data) == {"bob": ALL["bob"]}
    (data / "cars.csv").write_text(text.format("ann"))
    with pytest.raises(InputError, match="already belongs to 'bob'"):
        cars_by_manifest(data / "cars.csv")


@pytest.mark.parametrize(
    "name", ["drive [1].csv", "a*b?.csv", "x" * 251 + ".csv", b"\xff\xfe.csv"]
)
@pytest.mark.parametrize("given", ["file", "folder", "manifest"])
def test_names_of_all_kinds_are_found(data, name, given):
    path = data / "carl" / (name if isinstance(name, str) else os.fsdecode(name))
    path.parent.mkdir()
    path.write_text("t_s\n")
    if given == "manifest":
        if not isinstance(name, str):
            return  # A manifest is UTF-8; such a drive is listed by its folder.
        (data / "cars.csv").write_text(f"drive,car,vehicle\ncarl/{name},carl,nissan_leaf\n")
        cars = cars_by_manifest(data / "cars.csv")
    else:
        cars = cars_by_folder([str(path if given == "file" else path.parent)], LEAF)
    assert [(car.car, car.drives) for car in cars] == [("carl", (path,))]


def test_yaml(data):
    manifest = data / "fleet.yaml"
    manifest.write_text(
        "cars:\n"
        "  ann's: {vehicle: bmw_i3, drives: data/ann}\n"
        "  ../bob: {vehicle: nissan_leaf, drives: 'data/bob/*.mcap'}\n"
    )
    cars = cars_by_manifest(manifest)
    assert names_of(cars, data) == {"ann's": ALL["ann"], "../bob": ALL["bob"]}
    assert [car.vehicle.key for car in cars] == ["nissan_leaf", "bmw_i3"]
    assert all("/" not in car.folder_name for car in cars)


def test_csv(data):
    manifest = data / "fleet.csv"
    manifest.write_text(
        "drive,car,vehicle\n"
        "data/bob/first.mcap,b,nissan_leaf\n"
        "other/bob,b,nissan_leaf\n"
        "data/ann,a,bmw_i3\n"
    )
    assert names_of(cars_by_manifest(manifest), data) == {
        "a": ALL["ann"],
        "b": ["data/bob/first.mcap", "other/bob/third.mcap"],
    }


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("drive,car\n", ":1: the columns must be drive, car, vehicle"),
        ("drive,car,vehicle\ndata/bob,b\n", ":2: expected drive, car, vehicle"),
        ("drive,car,vehicle\ndata/bob,b,bmw_i3\ndata/bob,c,bmw_i3\n", ":3: .* belongs to 'b'"),
        ("drive,car,vehicle\ndata/bob,b,bmw_i3\ndata/ann,b,bmw_i4\n", ":3: car 'b' is a bmw_i4"),
        ("drive,car,vehicle\ndata/bob,..,bmw_i3\n", "cannot be named '..'"),
    ],
)
def test_a_wrong_csv_is_refused(data, text, reason):
    manifest = data / "fleet.csv"
    manifest.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=reason):
        cars_by_manifest(manifest)


def test_a_manifest_without_an_end_is_not_read(data):
    """A file of holes costs its author nothing; a line of it filled the memory."""
    path = data / "fleet.csv"
    path.write_bytes(b"drive,car,vehicle\n")
    os.truncate(path, 3 << 30)
    with pytest.raises(InputError, match=r"fleet\.csv: larger than 10000000 bytes"):
        cars_by_manifest(path)


def test_a_pattern_walks_the_folders_once(data):
    """Eight ** over forty folders in each other did not end."""
    deep = data.joinpath(*["d"] * 40)
    deep.mkdir(parents=True)
    path = data / "fleet.yaml"
    path.write_text("cars: {one: {vehicle: generic, drives: 'd/" + "**/" * 8 + "x.csv'}}")
    with pytest.raises(InputError, match=r"more than one \*\* in a pattern"):
        cars_by_manifest(path)


def test_a_folder_before_a_pattern_is_none(data):
    folder = data / "old [1]"
    folder.mkdir()
    (folder / "a.csv").write_text("t_s,speed_mps,power_w\n")
    for given in (f"{folder}/*.csv", f"{folder}/a?csv"):
        assert cars_by_folder([given], LEAF)[0].drives == (folder / "a.csv",)
    (data / "a*[b]?.csv").write_text("t_s,speed_mps,power_w\n")
    (data / "axb1.csv").write_text("t_s,speed_mps,power_w\n")
    (car,) = cars_by_folder([f"{data}/a*[b]?.csv"], LEAF)
    assert car.drives == (data / "a*[b]?.csv",), "what is there by its very name"


def test_the_folder_of_a_manifest_is_no_pattern(data):
    folder = data / "old [1]"
    folder.mkdir()
    (folder / "a.csv").write_text("t_s,speed_mps,power_w\n")
    path = folder / "fleet.csv"
    path.write_text("drive,car,vehicle\na*.csv,one,generic\n")
    assert cars_by_manifest(path)[0].drives == (folder / "a.csv",)
