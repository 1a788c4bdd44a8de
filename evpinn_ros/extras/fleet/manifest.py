"""Finds the drives of each car, by folders or by a manifest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import csv
from dataclasses import dataclass
from io import StringIO
import os
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import read_whole
from evpinn_ros.common.yaml_section import compose
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.logs.formats import recordings

COLUMNS = ("drive", "car", "vehicle")
YAML = (".yaml", ".yml")
MOST_BYTES = 10_000_000  # of a CSV: 100 000 drives


@dataclass(frozen=True, slots=True)
class CarDrives:
    """A car of the fleet and its drives."""

    car: str  # its name
    vehicle: Vehicle  # the model
    drives: tuple[Path, ...]  # absolute paths, in no order yet

    @property
    def folder_name(self) -> str:
        """The name of the car as a name of a folder."""
        return quote(self.car, safe=" ")


class _Line(NamedTuple):
    where: str
    pattern: str
    car: str
    vehicle: str


def cars_by_folder(inputs: Sequence[str], vehicle: Vehicle) -> list[CarDrives]:
    """A car for each folder in a given one, or for the given folder if it has drives itself.

    Inputs are files, folders or patterns; all cars have the same vehicle file.

    Raises:
        InputError: there are no drives, or two folders have the same name.
    """
    drives: dict[Path, set[Path]] = {}
    seen: set[str] = set()
    for given in inputs:
        for path in _matching(given, Path()):
            for drive in _recordings(path, seen):
                drives.setdefault(_top_folder(path, drive), set()).add(drive)
    named: dict[str, Path] = {}
    for folder in drives:
        if named.setdefault(folder.name, folder) != folder:
            raise InputError(
                f"{named[folder.name]} and {folder} would both be car '{folder.name}'; "
                "assign the drives in a --manifest"
            )
    return _fleet((folder.name, vehicle, paths) for folder, paths in drives.items())


def cars_by_manifest(path: Path) -> list[CarDrives]:
    """Cars of a YAML or CSV manifest; paths in it are relative to it.

    The YAML has `cars`, from names to `vehicle` and `drives`; the CSV has columns drive, car and
    vehicle.

    Raises:
        InputError: the file is unreadable, empty or contradictory.
    """
    drives: dict[str, set[Path]] = {}
    models: dict[str, str] = {}
    vehicles: dict[str, Vehicle] = {}
    owner: dict[str, str] = {}
    for line in _csv_lines(path) if path.suffix.lower() == ".csv" else _yaml_lines(path):
        if models.setdefault(line.car, line.vehicle) != line.vehicle:
            first = models[line.car]
            raise InputError(f"{line.where}: car '{line.car}' is a {line.vehicle} and a {first}")
        if line.vehicle not in vehicles:
            with as_input_error(line.where, InputError):
                vehicles[line.vehicle] = load_model(line.vehicle, path.parent)
        for matched in _matching(line.pattern, path.parent, line.where):
            for drive in _recordings(matched):
                real = os.path.realpath(drive)  # two names may be links to one drive
                if real not in owner:
                    drives.setdefault(line.car, set()).add(drive)
                if owner.setdefault(real, line.car) != line.car:
                    raise InputError(f"{line.where}: {drive} already belongs to '{owner[real]}'")
    return _fleet((car, vehicles[models[car]], path) for car, path in drives.items())


def load_model(name: str, base: Path) -> Vehicle:
    """A vehicle by its name, or by the absolute path of its file."""
    return load_vehicle((base / name).resolve() if Path(name).suffix in YAML else name)


def _fleet(cars: Iterable[tuple[str, Vehicle, set[Path]]]) -> list[CarDrives]:
    fleet = [CarDrives(car, vehicle, tuple(sorted(drives))) for car, vehicle, drives in cars]
    if not fleet:
        raise InputError("no bag, CAN log or CSV to learn from")
    models: dict[str, Vehicle] = {}
    for car_drives in fleet:
        if car_drives.folder_name in ("", ".", ".."):
            raise InputError(f"a car cannot be named '{car_drives.car}'; name it in a --manifest")
        if repr(models.setdefault(car_drives.vehicle.key, car_drives.vehicle)) != repr(
            car_drives.vehicle
        ):
            raise InputError(f"two vehicle files are both named {car_drives.vehicle.key}")
    return sorted(fleet, key=lambda car_drives: car_drives.car)


def _top_folder(given: Path, drive: Path) -> Path:
    inside = drive.relative_to(given).parts
    if len(inside) > 1:
        return given / inside[0]
    return given if inside else given.parent


def _recordings(path: Path, seen: set[str] | None = None) -> list[Path]:
    with as_input_error():
        return list(recordings(path, seen))


def _matching(pattern: str, base: Path, where: str = "") -> list[Path]:
    path = base / pattern
    paths = [path]
    if not path.exists():
        if pattern.count("**") > 1:  # each further one walks all folders below each folder
            raise InputError(f"{where or pattern}: more than one ** in a pattern")
        with as_input_error(where or pattern, ValueError):
            # The name of an existing file is not a pattern, whatever it contains.
            folder = next(parent for parent in path.parents if parent.exists())
            paths = list(folder.glob(str(path.relative_to(folder))))
    if not paths:
        raise InputError(f"{where or path}: {pattern}: nothing there")
    return [path.resolve() for path in paths]


def _yaml_lines(path: Path) -> Iterator[_Line]:
    root = compose(path, "fleet manifest")
    root.refuse_unknown(("cars",))
    cars = root.section("cars")
    for name in cars.names():
        car = cars.section(name)
        car.refuse_unknown(("vehicle", "drives"))
        yield _Line(f"{path}: {name}", car.text("drives"), name, car.text("vehicle"))


def _csv_lines(path: Path) -> Iterator[_Line]:
    with as_input_error(path, UnicodeDecodeError, csv.Error):
        text = read_whole(path, MOST_BYTES, "a manifest").decode("utf-8-sig")
        rows = csv.DictReader(StringIO(text, newline=""))
        if set(rows.fieldnames or ()) != set(COLUMNS):
            raise InputError(f"{path}:1: the columns must be {', '.join(COLUMNS)}")
        for row in rows:
            where = f"{path}:{rows.line_num}"
            cells = [(row[name] or "").strip() for name in COLUMNS]
            if not all(cells) or None in row:
                raise InputError(f"{where}: expected {', '.join(COLUMNS)}")
            yield _Line(where, *cells)
