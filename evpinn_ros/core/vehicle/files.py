"""Reads and writes vehicle files, one YAML file per car model, and finds cars by name.

An invalid file raises `InputError` with path, line and reason; nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, replace
from difflib import get_close_matches
from functools import cache
from itertools import combinations
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from evpinn_ros.common.errors import InputError, printable
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.common.writer import write_file
from evpinn_ros.common.yaml_section import Section, compose
from evpinn_ros.core.vehicle.certified import FRONTAL_AREA, certified_cars, words_of
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES, Limits, Parameters, Prior
from evpinn_ros.core.vehicle.physics import RegenForm, battery_power
from evpinn_ros.core.vehicle.rated import rated_cars

GENERIC = "generic"  # a passenger car of which no more is known; its size is learned


class Constant(NamedTuple):
    """A quantity of the vehicle file that is not learned."""

    lower: float
    upper: float
    unit: str


CONSTANTS: Mapping[str, Constant] = {
    "frontal_area": Constant(0.1, 20.0, "m^2"),
    "air_density": Constant(0.5, 2.0, "kg/m^3"),
    "beta": Constant(-2.0, 0.0, "m/s^2"),
    "nominal_voltage": Constant(10.0, 2000.0, "V"),
    "rotating_mass_factor": Constant(1.0, 1.5, "1"),
    "battery_capacity": Constant(1e6, 5e9, "J"),
    "nominal_speed": Constant(0.1, 100.0, "m/s"),
    "motor_ratio": Constant(1.0, 200.0, "rad/m"),
    "relative_size": Constant(0.005, 50.0, "1"),
}
KEYS = ("name", "can_profile", "parameters", "correlations", "paper_start")
OPTIONAL_CONSTANTS = {
    "battery_capacity": math.nan,
    "motor_ratio": math.nan,
    "nominal_speed": math.nan,
    "relative_size": 1.0,
}
EXTENSIVE = ("mass", "p_aux")  # parameters that scale with the size of a vehicle
LEAST_EIGENVALUE = 1e-3  # of correlations; below it one parameter follows from the others
FEW, LIKENESS = 8, 0.6  # most names that an error lists, and least similarity of a suggestion
# Value and 1-sigma, of vehicles smaller and larger than a car. Small drivetrains lose more and
# regenerate less; tyres and bodies vary widely. Without cabin and heating, computer and lights are
# the load; a truck or bus has larger loads.
SMALL = {"eta": (0.78, 0.12), "mu": (0.5, 0.3), "c_rr": (0.012, 0.007), "c_d": (0.5, 0.25),
         "p_aux": (50.0, 60.0)}  # fmt: skip
LARGE = {"eta": (0.86, 0.08), "mu": (0.7, 0.2), "c_rr": (0.0075, 0.003), "c_d": (0.6, 0.2),
         "p_aux": (2000.0, 2000.0)}  # fmt: skip
MASS_SHARE = 0.4  # 1-sigma of the mass of a vehicle whose size was learned
AREA_POWER = 2.0 / 3.0  # areas grow with the square of a length, masses with its cube
SLOWEST_TRAFFIC = 2.0  # m/s, of cars on roads; a slower vehicle is a robot
LEAST_FACTOR = 1e-3  # all but p_aux are learned as logarithms, so none of them is zero


@dataclass(frozen=True, slots=True)
class Vehicle:
    """One car model: its constants, and the prior of every parameter to be learned.

    Attributes:
        key: short name, the file's stem.
        name: name for people.
        can_profile: name in `config/can/`, path of a file, or None.
        frontal_area: m^2.
        air_density: kg/m^3, used while no temperature is known.
        beta: deceleration threshold of regeneration, m/s^2 (eq. 20).
        nominal_voltage: V, used when a log holds power alone.
        rotating_mass_factor: effective over static mass (wheels, rotor).
        battery_capacity: usable energy, J, NaN if unknown.
        motor_ratio: rad of the motor per m of road, NaN if unknown.
        priors: one `Prior` for each of `PARAMETER_NAMES`.
        nominal_speed: m/s, assumed on a path without times; NaN if unknown.
        relative_size: mass over that of a passenger car (`similar_car`).
        correlations: of priors, by pairs of names; missing pairs have 0.
        paper_start: priors of the EV-PINN paper (eq. 24, 25); empty: those of `priors`.
    """

    key: str
    name: str
    can_profile: str | None
    frontal_area: float
    air_density: float
    beta: float
    nominal_voltage: float
    rotating_mass_factor: float
    battery_capacity: float
    motor_ratio: float
    priors: Mapping[str, Prior]
    nominal_speed: float = math.nan
    relative_size: float = 1.0
    correlations: Mapping[tuple[str, str], float] = field(default_factory=dict)
    paper_start: Mapping[str, Prior] = field(default_factory=dict)

    def __hash__(self) -> int:
        """By its key alone, for mappings have no hash."""
        return hash(self.key)

    @property
    def initial(self) -> Parameters:
        """The prior values, the start of every estimate."""
        return Parameters(*(self.priors[name].value for name in PARAMETER_NAMES))

    @property
    def as_published(self) -> Vehicle:
        """The car with `paper_start` as its priors, for `mode: paper` and `evpinn reproduce`."""
        if not self.paper_start:
            return self
        return replace(self, priors=self.paper_start, correlations={}, paper_start={})

    @property
    def in_traffic(self) -> bool:
        """False for a robot, to which assumptions about roads and drivers do not apply."""
        return not self.nominal_speed < SLOWEST_TRAFFIC

    @property
    def similar_car(self) -> Vehicle:
        """The passenger car that this vehicle is learned as (`estimation.size`).

        At equal speeds, its energies are those of this vehicle over `relative_size`.
        """
        if self.relative_size == 1.0:
            return self
        return replace(
            self,
            relative_size=1.0,
            frontal_area=self.frontal_area / self.relative_size,
            battery_capacity=self.battery_capacity / self.relative_size,
            priors=self._similar(self.priors),
            paper_start=self._similar(self.paper_start),
        )

    def of_size(self, size: float) -> Vehicle:
        """A vehicle of this size relative to a passenger car, about which no more is known.

        Its priors are wide: it may be a robot, a three-wheeler, a truck or a bus.
        """
        if size == self.relative_size:
            return self
        source = f"any vehicle of {100 * size:.3g} % of a passenger car"
        priors = {
            name: Prior(*values, source) for name, values in (SMALL if size < 1 else LARGE).items()
        }
        mass = size * self.priors["mass"].value
        priors["mass"] = Prior(mass, MASS_SHARE * mass, source)
        return replace(
            self,
            relative_size=size,
            frontal_area=size**AREA_POWER * self.frontal_area,
            priors={name: priors[name] for name in PARAMETER_NAMES},
            correlations={},
            paper_start={},
        )

    def _similar(self, priors: Mapping[str, Prior]) -> dict[str, Prior]:
        scaled = dict(priors)
        for name in EXTENSIVE if scaled else ():
            value, std, source = astuple(scaled[name])
            scaled[name] = Prior(value / self.relative_size, std / self.relative_size, source)
        return scaled

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of all parameters, in the order of `PARAMETER_NAMES`, shape (6, 6)."""
        return _matrix(self.correlations)

    def power(
        self,
        speed: Any,
        acceleration: Any,
        parameters: Parameters,
        form: RegenForm,
        *,
        air_density: Any = None,
        grade: Any = 0.0,
    ) -> Any:
        """Battery power of the car with these parameters, W (see `battery_power`)."""
        return battery_power(
            speed,
            acceleration,
            parameters,
            area=self.frontal_area,
            air_density=self.air_density if air_density is None else air_density,
            form=form,
            beta=self.beta,
            grade=grade,
        )


def vehicle_names() -> list[str]:
    """Names of the vehicle files that come with the package."""
    return sorted(path.stem for path in _vehicle_directory().glob("*.yaml"))


def find_vehicles(text: str = "") -> dict[str, str]:
    """Names, by key, of the known cars whose name or key contains all words of `text`.

    Hyphens and spaces within a word make no difference: `e208` and `e 208` are the e-208.
    """
    words = words_of(text)
    spellings = set(words), {"".join(words)}

    def has(key: str, name: str) -> bool:
        names = _joined(words_of(key)) | _joined(words_of(name))
        return any(spelling <= names for spelling in spellings)

    return {key: name for key, name in _names() if has(key, name)}


def _joined(words: Sequence[str]) -> set[str]:
    """The words, and up to three consecutive ones joined without a space."""
    places = range(len(words))
    return {"".join(words[i:j]) for i in places for j in (i + 1, i + 2, i + 3)}


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """The car of a vehicle file, by its name (`tesla_model_3_lr`) or path.

    Certified cars (`vehicle.certified`) and rated ones (`vehicle.rated`) have a name and no file.
    Words suffice that match one name only, or that are one whole name without its make.

    Raises:
        InputError: no car or several match, or the file is invalid (with path, line and reason).
    """
    path = Path(name_or_path)
    text = str(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return _parse(path)
    if path.suffix == ".json":
        raise InputError(f"{path}: a vehicle file ends in .yaml; is this a --state?")
    key = text if text in known_vehicles() else _key_of(text)
    if key in certified_cars():
        return _certified(key)
    return _rated(key) if key in rated_cars() else _parse(_file(key))


def known_vehicles() -> list[str]:
    """Names that `load_vehicle` takes: of files, certified cars and rated cars."""
    return [*vehicle_names(), *certified_cars(), *rated_cars()]


def _names() -> Iterator[tuple[str, str]]:
    """Key and name of every known car."""
    for key in vehicle_names():
        yield key, compose(_file(key), "vehicle file").text("name")
    for key, car in certified_cars().items():
        yield key, car.name
    for key, rated in rated_cars().items():
        yield key, rated.name


def _key_of(text: str) -> str:
    words = words_of(text)
    named = find_vehicles(text) if words else {}
    # Cars with a measured road load come before rated ones.
    candidates = {key: name for key, name in named.items() if key not in rated_cars()} or named
    close = [key for key, name in candidates.items() if {*words_of(name)[1:]} <= {*words}]
    for keys in (list(candidates), close):
        if len(keys) == 1:
            return keys[0]
    if candidates:
        raise InputError(f"several vehicles match {text!r}: {_listing([*candidates])}")
    names = known_vehicles()
    near = get_close_matches("_".join(words), names, FEW // 2, LIKENESS)
    meant = f"did you mean {', '.join(near)}" if near else f"known are {_listing(names)}"
    raise InputError(
        f"no vehicle named {text!r}; {meant}; `generic` is any car, `evpinn vehicles` lists all"
    )


def _listing(names: Sequence[str]) -> str:
    return ", ".join(names[:FEW]) + (", ..." if len(names) > FEW else "")


@cache
def _generic() -> Vehicle:
    return _parse(_file(GENERIC))


def _rated(key: str) -> Vehicle:
    """The generic car, its priors conditioned on this car's ratings."""
    any_car, car = _generic(), rated_cars()[key]
    priors, correlations = car.given(any_car.priors, any_car.correlation)
    return replace(
        any_car,
        key=key,
        name=car.name,
        can_profile=car.can_profile,
        battery_capacity=car.battery,
        priors=priors,
        correlations=correlations,
    )


def _certified(key: str) -> Vehicle:
    car = certified_cars()[key]
    return Vehicle(
        key=key,
        name=car.name,
        can_profile=car.can_profile,
        frontal_area=FRONTAL_AREA,
        air_density=1.2,  # dry air at 20 degC and sea level
        beta=-0.045,  # EV-PINN paper, eq. 20
        nominal_voltage=360.0,  # 96 cells of 3.75 V
        rotating_mass_factor=1.03,  # wheels and rotor, typical of single-speed electric cars
        battery_capacity=load_vehicle(car.pack_of).battery_capacity if car.pack_of else math.nan,
        motor_ratio=math.nan,
        priors=car.priors,
    )


def _file(key: str) -> Path:
    return _vehicle_directory() / f"{key}.yaml"


def _vehicle_directory() -> Path:
    return share_directory() / "config" / "vehicles"


def _parse(path: Path, text: str | None = None) -> Vehicle:
    root = compose(path, "vehicle file", text)
    constants = {key: _constant(root.section(key), key) for key in CONSTANTS if root.has(key)}
    size = constants.get("relative_size", OPTIONAL_CONSTANTS["relative_size"])
    priors = _priors(root.section("parameters"), size)
    root.refuse_unknown((*KEYS, *CONSTANTS))
    for key in CONSTANTS:
        if key not in constants and key not in OPTIONAL_CONSTANTS:
            raise root.error(f"'{key}' is missing")
    constants = {**OPTIONAL_CONSTANTS, **constants}
    return Vehicle(
        key=path.stem,
        name=root.text("name"),
        can_profile=_can_profile(root) if root.has("can_profile") else None,
        priors=priors,
        correlations=_correlations(root.section("correlations"))
        if root.has("correlations")
        else {},
        paper_start=_priors(root.section("paper_start"), size) if root.has("paper_start") else {},
        **constants,
    )


def limits_of(name: str, size: float) -> Limits:
    """Possible range of a parameter of a vehicle of this size."""
    return Limits(*(size * limit for limit in LIMITS[name])) if name in EXTENSIVE else LIMITS[name]


def _priors(section: Section, size: float) -> dict[str, Prior]:
    """One for each of `PARAMETER_NAMES`."""
    priors = {
        name: _prior(section.section(name), name, limits_of(name, size))
        for name in PARAMETER_NAMES
    }
    section.refuse_unknown(PARAMETER_NAMES)
    return priors


def _correlations(section: Section) -> dict[tuple[str, str], float]:
    """Correlations by pair; a file has each under its first name in `PARAMETER_NAMES`."""
    section.refuse_unknown(("source", *PARAMETER_NAMES))
    section.text("source")
    given = {name: section.section(name) for name in PARAMETER_NAMES if section.has(name)}
    for name, others in given.items():
        later = PARAMETER_NAMES[PARAMETER_NAMES.index(name) + 1 :]
        others.refuse_unknown(later)
    correlations = {
        (name, other): given[name].number(other, -1.0, 1.0)
        for name, other in combinations(PARAMETER_NAMES, 2)
        if name in given and given[name].has(other)
    }
    if np.linalg.eigvalsh(_matrix(correlations)).min() < LEAST_EIGENVALUE:
        raise section.error("the matrix of correlations is not positive definite")
    return correlations


def _matrix(correlations: Mapping[tuple[str, str], float]) -> np.ndarray:
    """Shape (6, 6), symmetric."""
    matrix = np.eye(len(PARAMETER_NAMES))
    for pair, value in correlations.items():
        row, other = map(PARAMETER_NAMES.index, pair)
        matrix[row, other] = matrix[other, row] = value
    return matrix


def _can_profile(root: Section) -> str:
    """The name of a profile, or its path if the file gives one, which is relative to itself."""
    name = root.text("can_profile")
    is_path = Path(name).suffix in (".yaml", ".yml")
    return str(root.path_beside("can_profile")) if is_path else name


def _constant(section: Section, name: str) -> float:
    section.refuse_unknown(("value", "source"))
    section.text("source")
    return section.number("value", CONSTANTS[name].lower, CONSTANTS[name].upper)


def _prior(section: Section, name: str, limits: Limits) -> Prior:
    section.refuse_unknown(("value", "std", "source"))
    least = limits.lower if name == "p_aux" else max(limits.lower, LEAST_FACTOR)
    value = section.number("value", least, limits.upper)
    std = section.number("std", 1e-9, limits.upper)
    return Prior(value, std, section.text("source"))


def write_vehicle(path: Path, vehicle: Vehicle) -> None:
    """Write a vehicle file that `load_vehicle` takes.

    Raises:
        OSError: the file cannot be written.
        InputError: the vehicle is not valid; nothing is written.
    """
    text = vehicle_text(vehicle, path.parent)
    _parse(path, text)
    write_file(path, text)


def vehicle_text(vehicle: Vehicle, folder: Path) -> str:
    """The content of a vehicle file in `folder`; a comment names a CAN profile outside of it."""
    document: dict[str, Any] = {"name": vehicle.name}
    comment, profile = "", vehicle.can_profile
    if profile is not None and Path(profile).suffix in (".yaml", ".yml"):
        whole = Path(profile).resolve()
        is_beside = whole.is_relative_to(folder.resolve())
        profile = str(whole.relative_to(folder.resolve())) if is_beside else None
        comment = (
            "" if is_beside else f"# Not beside this file: --can-profile {printable(str(whole))}\n"
        )
    if profile is not None:
        document["can_profile"] = profile
    for name in CONSTANTS:
        value = getattr(vehicle, name)
        if math.isfinite(value) and value != OPTIONAL_CONSTANTS.get(name):
            document[name] = {"value": value, "source": f"vehicle {vehicle.key}"}
    document["parameters"] = _plain_priors(vehicle.priors)
    if vehicle.correlations:
        document["correlations"] = {"source": f"vehicle {vehicle.key}"}
        for (name, other), value in vehicle.correlations.items():
            document["correlations"].setdefault(name, {})[other] = value
    if vehicle.paper_start:
        document["paper_start"] = _plain_priors(vehicle.paper_start)
    return comment + yaml.safe_dump(document, sort_keys=False, width=99)


def _plain_priors(priors: Mapping[str, Prior]) -> dict[str, Any]:
    return {name: asdict(priors[name]) for name in PARAMETER_NAMES}
