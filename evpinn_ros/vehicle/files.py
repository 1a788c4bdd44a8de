"""Vehicle files: one YAML file per car model, read strictly.

A wrong file is refused with its path, the line and the reason; nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import NamedTuple

from evpinn_ros.errors import InputError
from evpinn_ros.share import share_directory
from evpinn_ros.vehicle.parameters import LIMITS, PARAMETER_NAMES, Parameters, Prior
from evpinn_ros.yaml_section import Section, compose


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
}
OPTIONAL_CONSTANTS = ("battery_capacity", "motor_ratio", "nominal_speed")
LEAST_FACTOR = 1e-3  # all but p_aux is learned as a logarithm, which zero has not


@dataclass(frozen=True, slots=True)
class Vehicle:
    """One car model: what is known of it, and the prior of every parameter to be learned.

    Attributes:
        key: short name, the file's stem.
        name: name for people.
        can_profile: for its bus: a name in `config/can/`, the path of a file, or None.
        frontal_area: m^2.
        air_density: kg/m^3, used while no temperature is known.
        beta: deceleration threshold of regeneration, m/s^2 (eq. 20).
        nominal_voltage: V, used when a log holds power alone.
        rotating_mass_factor: effective over static mass when accelerating (wheels, rotor).
        battery_capacity: usable energy, J, NaN if unknown.
        motor_ratio: rad that the motor turns per m of road, NaN if unknown; used where a bus
            tells its torque and not its speed.
        priors: one `Prior` for each of `PARAMETER_NAMES`.
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

    @property
    def initial(self) -> Parameters:
        """The prior values, the start of every estimate (eq. 24, 25)."""
        return Parameters(*(self.priors[name].value for name in PARAMETER_NAMES))


def vehicle_names() -> list[str]:
    """Names of the vehicle files that come with the package."""
    return sorted(path.stem for path in _vehicle_directory().glob("*.yaml"))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle file given by its name (`tesla_model_3_lr`) or by its path.

    Raises:
        InputError: no such file, or the file is wrong; the text has file, line and reason.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        if str(name_or_path) not in vehicle_names():
            known = ", ".join(vehicle_names())
            raise InputError(
                f"no vehicle named {str(name_or_path)!r}; known are {known}, or give a path"
            )
        path = _vehicle_directory() / f"{name_or_path}.yaml"
    return _parse(path)


def _vehicle_directory() -> Path:
    return share_directory() / "config" / "vehicles"


def _parse(path: Path) -> Vehicle:
    root = compose(path, "vehicle file")
    constants = {key: _constant(root.section(key), key) for key in CONSTANTS if root.has(key)}
    parameters = root.section("parameters")
    priors = {name: _prior(parameters.section(name), name) for name in PARAMETER_NAMES}
    parameters.refuse_unknown(PARAMETER_NAMES)
    root.refuse_unknown(("name", "can_profile", "parameters", *CONSTANTS))
    for key in CONSTANTS:
        if key not in constants and key not in OPTIONAL_CONSTANTS:
            raise root.error(f"'{key}' is missing")
    for key in OPTIONAL_CONSTANTS:
        constants.setdefault(key, math.nan)
    return Vehicle(
        key=path.stem,
        name=root.text("name"),
        can_profile=_can_profile(root) if root.has("can_profile") else None,
        priors=priors,
        **constants,
    )


def _can_profile(root: Section) -> str:
    """The name of a profile, or the path of one beside the vehicle file."""
    name = root.text("can_profile")
    is_path = Path(name).suffix in (".yaml", ".yml")
    return str(root.path_beside("can_profile")) if is_path else name


def _constant(section: Section, name: str) -> float:
    section.refuse_unknown(("value", "source"))
    section.text("source")
    return section.number("value", CONSTANTS[name].lower, CONSTANTS[name].upper)


def _prior(section: Section, name: str) -> Prior:
    section.refuse_unknown(("value", "std", "source"))
    limits = LIMITS[name]
    least = limits.lower if name == "p_aux" else max(limits.lower, LEAST_FACTOR)
    value = section.number("value", least, limits.upper)
    std = section.number("std", 1e-9, limits.upper)
    return Prior(value, std, section.text("source"))
