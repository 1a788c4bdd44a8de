"""Three electric cars of another simulator, SUMO (MMPEVEM), each for an hour in traffic.

The parameters and loss maps of BMW i3, VW ID.3 and Peugeot e-208 come with `eclipse-sumo`; power
comes from its emission model (Koch et al., doi 10.1109/ITSC48978.2021.9564463;
https://sumo.dlr.de/docs/Models/MMPEVEM.html). Readings are speed, height and power without noise.
A car follows a corridor of town, country and motorway among traffic, ten steps a second.

Truth is what the hour's noise-free power determines (`noise_free`): SUMO's losses without torque
act as a force of 30 to 130 N, as much as that of the tyres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import importlib.util
import math
from pathlib import Path
import subprocess
import tempfile
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

from benchmarks.unseen.noise_free import Moved, noise_free_truth
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.units import KMH
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.simulation.drive import HillyRoad, hilly_road
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, RMS_GRADE

SUMO_CARS = {
    "sumo_i3": "BMW_i3.xml",
    "sumo_id3": "VW_ID3.xml",
    "sumo_e208": "Peugeot_e-208.rou.xml",
}
SEED, SECONDS, STEP = 20, 3600, 0.1  # s, s
PIECE = 100.0  # m of road with one slope
# Sections of the corridor: limits km/h, lengths m, chance to stop at the end.
SECTIONS = (
    ((30, 50, 50), (150.0, 600.0), 0.4),
    ((70, 80, 100), (500.0, 3000.0), 0.1),
    ((110, 120, 130), (1500.0, 5000.0), 0.0),
)
STOP_S = (4.0, 35.0)
OTHERS = 60  # cars ahead
AIR = 1.204  # kg/m^3, of the model


def sumo_is_there() -> bool:
    """True if SUMO and its library are installed."""
    return all(importlib.util.find_spec(name) is not None for name in ("sumo", "libsumo"))


@dataclass(frozen=True)
class Powertrain:
    """A vehicle type of SUMO: its parameters by name."""

    name: str
    mass: float
    parameters: dict[str, str]

    def __getitem__(self, name: str) -> float:
        """A parameter as a number."""
        return float(self.parameters[name])


@dataclass(frozen=True)
class Corridor:
    """Pieces of road one after the other."""

    length: np.ndarray  # m
    limit: np.ndarray  # m/s
    stop: np.ndarray  # s at the end
    road: HillyRoad  # heights


def simulate_sumo(key: str) -> tuple[tuple[Reading, ...], np.ndarray]:
    """Drive a car for an hour.

    Returns:
        Its readings, and its trace of shape (n, 4): speed at the end of a step m/s, acceleration
        m/s^2, slope rad, power W.

    Raises:
        InputError: SUMO fails.
    """
    import libsumo

    rng = np.random.default_rng(SEED)
    corridor = _corridor(rng)
    with tempfile.TemporaryDirectory() as folder:
        _write_network(Path(folder), corridor)
        _write_routes(Path(folder), corridor, powertrain(key), rng)
        options = ("-n net.xml", "-r routes.xml", f"--step-length {STEP}", f"--seed {SEED}")
        flags = "--step-method.ballistic --no-step-log --no-warnings --default.speeddev 0.1"
        command = " ".join((*options, flags)).replace(" net", f" {folder}/net")
        command = command.replace(" routes", f" {folder}/routes")
        try:
            libsumo.start(["sumo", *command.split()])
            rows = np.array(list(_drive(libsumo)))
        except libsumo.TraCIException as error:
            raise InputError(f"SUMO: {error}") from error
        finally:
            libsumo.close()
    height = rows[:, 4]
    return tuple(_readings(rows[:, 0], rows[:, 3], height)), rows[:, :4]


def powertrain(key: str) -> Powertrain:
    """The vehicle type that SUMO ships."""
    import sumo

    path = Path(sumo.SUMO_HOME) / "data" / "emissions" / "MMPEVEM" / SUMO_CARS[key]
    element = ElementTree.parse(path).getroot().find("vType")
    if element is None:
        raise InputError(f"{path}: holds no vehicle type")
    parameters = {
        parameter.attrib["key"]: parameter.attrib["value"] for parameter in element.iter("param")
    }
    return Powertrain(element.attrib["id"], float(element.attrib["mass"]), parameters)


def sumo_truth(key: str, trace: np.ndarray, vehicle: Vehicle) -> dict[str, float]:
    """The combinations that this hour determines, of an unlimited sensor (`noise_free`)."""
    v, a, slope, power = trace[np.isfinite(trace).all(axis=1)].T
    before = v - a * STEP
    climb = (before + v) / 2.0 * STEP * np.sin(slope)
    moved = Moved.between(before, v, np.full_like(v, STEP), climb)
    p_aux = powertrain(key)["constantPowerIntake"]
    return noise_free_truth(moved, power * STEP, p_aux, vehicle, AIR)


def _corridor(rng: np.random.Generator) -> Corridor:
    """Town, country and motorway in turn, long enough for the hour at the limits."""
    length, limit, stop = [], [], []
    seconds, kind = 0.0, 0
    while seconds < 1.3 * SECONDS:
        limits, lengths, chance = SECTIONS[kind % len(SECTIONS)]
        for _ in range(int(rng.integers(4, 10) if kind % 3 == 0 else rng.integers(2, 4))):
            allowed, section = float(rng.choice(limits)) * KMH, rng.uniform(*lengths)
            count = math.ceil(section / PIECE)
            stands = rng.uniform(*STOP_S) if rng.uniform() < chance else 0.0
            length += [section / count] * count
            limit += [allowed] * count
            stop += [0.0] * (count - 1) + [stands]
            seconds += section / allowed + stands
        kind += 1
    return Corridor(np.array(length), np.array(limit), np.array(stop), hilly_road(RMS_GRADE, rng))


def _write_network(folder: Path, corridor: Corridor) -> None:
    import sumo

    at = np.concatenate(([0.0], np.cumsum(corridor.length)))
    height = corridor.road.elevation(at)
    nodes = (
        f'<node id="n{i}" x="{x:.3f}" y="0" z="{z:.4f}"/>'
        for i, (x, z) in enumerate(zip(at, height, strict=True))
    )
    edges = (
        f'<edge id="e{i}" from="n{i}" to="n{i + 1}" numLanes="2" speed="{limit:.3f}"/>'
        for i, limit in enumerate(corridor.limit)
    )
    (folder / "nodes.xml").write_text(f"<nodes>{''.join(nodes)}</nodes>")
    (folder / "edges.xml").write_text(f"<edges>{''.join(edges)}</edges>")
    tool = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
    files = ("-n", folder / "nodes.xml", "-e", folder / "edges.xml", "-o", folder / "net.xml")
    ended = subprocess.run(
        [tool, *files, "--no-internal-links", "true", "--no-turnarounds", "true"],
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise InputError(f"netconvert: {ended.stderr.strip()}")


def _write_routes(
    folder: Path, corridor: Corridor, car: Powertrain, rng: np.random.Generator
) -> None:
    count = corridor.length.size
    parameters = "".join(
        f"<param key={quoteattr(name)} value={quoteattr(value)}/>"
        for name, value in car.parameters.items()
    )
    stops = "".join(
        f'<stop lane="e{i}_0" endPos="{corridor.length[i] - 1:.2f}" duration="{seconds:.1f}"/>'
        for i, seconds in enumerate(corridor.stop)
        if seconds
    )
    edges = [f"e{i}" for i in range(count)]
    starts = np.sort(rng.integers(2, count - 20, OTHERS))
    others = "".join(
        f'<vehicle id="other{i}" type="slow" depart="0" departPos="random" departSpeed="0">'
        f'<route edges="{" ".join(edges[start:])}"/></vehicle>'
        for i, start in enumerate(starts)
    )
    (folder / "routes.xml").write_text(
        "<routes>"
        '<vType id="slow" carFollowModel="IDM" accel="1.2" decel="2" '
        'speedFactor="normc(0.9,0.15,0.6,1.2)"/>'
        f'<vType id="car" emissionClass="MMPEVEM" mass="{car.mass}" carFollowModel="IDM" '
        f'accel="1.6" decel="1.8" speedFactor="1">{parameters}</vType>'
        f"{others}"
        '<vehicle id="ego" type="car" depart="0" departLane="0" departPos="0" departSpeed="0">'
        f'<route edges="{" ".join(edges)}"/>{stops}</vehicle>'
        "</routes>"
    )


def _drive(libsumo: object) -> Iterator[tuple[float, float, float, float, float]]:
    """Speed m/s, acceleration m/s^2, slope rad, power W, height m of each step."""
    car = libsumo.vehicle  # type: ignore[attr-defined]
    for _ in range(round(SECONDS / STEP)):
        libsumo.simulationStep()  # type: ignore[attr-defined]
        if "ego" not in car.getIDList():
            return
        yield (
            car.getSpeed("ego"),
            car.getAcceleration("ego"),
            math.radians(car.getSlope("ego")),
            car.getElectricityConsumption("ego") * 3600.0,
            car.getPosition3D("ego")[2],
        )


def _readings(speed: np.ndarray, power: np.ndarray, height: np.ndarray) -> Iterator[Reading]:
    """Speed and height at the end of each step, power at its middle."""
    voltage = 360.0
    for index, (v, p, z) in enumerate(zip(speed, power, height, strict=True)):
        end = EPOCH_NS + round((index + 1) * STEP * NANOSECONDS)
        if math.isfinite(p):
            middle = end - round(STEP / 2 * NANOSECONDS)
            yield BatteryReading(middle, voltage, -float(p) / voltage)
        yield SpeedReading(end, float(v))
        if index % round(1 / STEP) == 0:
            yield AltitudeReading(end, float(z))
