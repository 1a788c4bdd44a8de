from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.files import (
    CONSTANTS,
    OPTIONAL_CONSTANTS,
    limits_of,
    load_vehicle,
    vehicle_names,
    write_vehicle,
)
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES, Parameters

GOOD = """\
name: A car
frontal_area: {value: 2.2, source: "a sheet"}
air_density: {value: 1.2, source: "a sheet"}
beta: {value: -0.045, source: "the paper"}
nominal_voltage: {value: 350, source: "a sheet"}
rotating_mass_factor: {value: 1.03, source: "typical"}
parameters:
  eta: {value: 0.8, std: 0.1, source: "typical"}
  mu: {value: 0.6, std: 0.2, source: "typical"}
  mass: {value: 1800, std: 100, source: "a sheet"}
  c_rr: {value: 0.01, std: 0.002, source: "typical"}
  c_d: {value: 0.25, std: 0.02, source: "typical"}
  p_aux: {value: 600, std: 400, source: "typical"}
"""


@pytest.fixture
def car(tmp_path):
    """Writes a vehicle file; gives its path."""

    def write(text: str | bytes) -> Path:
        path = tmp_path / "a_car.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.mark.parametrize("name", vehicle_names())
def test_every_file_of_the_package_loads(name):
    vehicle = load_vehicle(name)
    assert vehicle.key == name and vehicle.name
    for parameter in PARAMETER_NAMES:
        prior = vehicle.priors[parameter]
        limits = limits_of(parameter, vehicle.relative_size)
        assert limits.lower < prior.value < limits.upper and prior.std > 0 and prior.source
    for constant, limits in CONSTANTS.items():
        value = getattr(vehicle, constant)
        missing = constant in OPTIONAL_CONSTANTS and value != value
        assert missing or limits.lower <= value <= limits.upper


def test_values_of_the_paper():
    three, s = load_vehicle("tesla_model_3_lr"), load_vehicle("tesla_model_s")
    starts = [car.as_published.initial for car in (three, s)]
    assert starts[0] == Parameters(0.7, 0.5, 1823.0, 0.0096, 0.23, 1100.0)  # eq. 24
    assert starts[1] == Parameters(0.7, 0.5, 2250.0, 0.0096, 0.23, 390.0)  # eq. 25
    assert (three.frontal_area, s.frontal_area) == (2.22, 2.40)  # section III.D
    assert {car.air_density for car in (three, s)} == {1.17}
    assert {car.beta for car in (three, s)} == {-0.045}  # eq. 20
    assert (three.can_profile, s.can_profile) == ("tesla_model_3", "tesla_model_s")


def test_a_file_by_its_path(car):
    vehicle = load_vehicle(car(GOOD))
    assert (vehicle.key, vehicle.name, vehicle.can_profile) == ("a_car", "A car", None)
    assert vehicle.initial == Parameters(0.8, 0.6, 1800.0, 0.01, 0.25, 600.0)
    assert vehicle.battery_capacity != vehicle.battery_capacity
    with_pack = load_vehicle(car(GOOD + 'battery_capacity: {value: 2e8, source: "a sheet"}\n'))
    assert with_pack.battery_capacity == 2e8
    assert load_vehicle(str(car(GOOD + "can_profile: nissan_leaf\n"))).can_profile == "nissan_leaf"


def test_limits_of_a_robot_are_those_of_a_car_by_its_size(car):
    robot = GOOD.replace("1800, std: 100", "60, std: 20").replace("600, std: 400", "30, std: 20")
    with pytest.raises(InputError, match="value = 60 is outside"):
        load_vehicle(car(robot))
    vehicle = load_vehicle(car(robot + 'relative_size: {value: 0.03, source: "60 kg"}\n'))
    assert vehicle.priors["mass"].value == 60.0
    similar = vehicle.similar_car
    assert similar.priors["mass"].value == pytest.approx(2000.0)
    assert similar.priors["p_aux"].std == pytest.approx(20.0 / 0.03)
    assert similar.frontal_area == pytest.approx(2.2 / 0.03)
    assert similar.priors["c_rr"] == vehicle.priors["c_rr"]


WRONG = [
    # what is replaced, by what, the line, words of the reason
    ("name: A car", "nam: A car", 1, "unknown key 'nam'"),
    ("name: A car\n", "", 1, "'name' is missing"),
    ("value: 1800", "value: -1800", 10, "mass: value = -1800 is outside [100, 60000]"),
    ('frontal_area: {value: 2.2, source: "a sheet"}', "frontal_area: 2.2", 2, "expected 'key"),
    ('  mass: {value: 1800, std: 100, source: "a sheet"}\n', "", 8, "'mass' is missing"),
    ("  eta:", '  c_d: {value: 0.2, std: 0.1, source: "x"}\n  eta:', 13, "'c_d' is given twice"),
]


@pytest.mark.parametrize(("old", "new", "line", "reason"), WRONG)
def test_a_wrong_file_is_refused_with_line_and_reason(car, old, new, line, reason):
    assert GOOD.count(old) == 1
    path = car(GOOD.replace(old, new))
    with pytest.raises(InputError) as refused:
        load_vehicle(path)
    text = str(refused.value)
    assert text.startswith(f"{path}:{line}: ") and "\n" not in text
    assert reason in text


def test_unknown_names_and_missing_files(tmp_path):
    with pytest.raises(InputError, match="no vehicle named 'zeppelin'; known are bmw_i3, bmw_i4"):
        load_vehicle("zeppelin")
    with pytest.raises(InputError, match="No such file"):
        load_vehicle(tmp_path / "absent.yaml")
    folder = tmp_path / "folder.yaml"
    folder.mkdir()
    with pytest.raises(InputError, match=r"folder\.yaml: Is a directory"):
        load_vehicle(folder)


@pytest.mark.parametrize("said, meant", [("nissan_leaf", "nissan_leaf"), ("my.yaml", None)])
def test_a_profile_of_ones_own_lies_beside_the_vehicle_file(tmp_path, said, meant):
    (tmp_path / "car.yaml").write_text(f"can_profile: {said}\n" + GOOD)
    assert load_vehicle(tmp_path / "car.yaml").can_profile == (meant or str(tmp_path / said))


def test_a_start_of_the_paper_is_not_the_prior(car):
    plain = load_vehicle(car(GOOD))
    assert plain.as_published is plain
    start = GOOD[GOOD.index("parameters") :].replace("parameters", "paper_start")
    path = car(GOOD + start.replace("value: 0.8", "value: 0.7"))
    vehicle = load_vehicle(path)
    assert (vehicle.initial.eta, vehicle.as_published.initial.eta) == (0.8, 0.7)
    written = path.with_name("written.yaml")  # the one that was read is not written over
    write_vehicle(written, vehicle)
    assert load_vehicle(written).paper_start == vehicle.paper_start
    with pytest.raises(InputError, match=r"a_car\.yaml:15: .*paper_start: 'c_d' is missing"):
        load_vehicle(car(GOOD + start.replace("  c_d:", "  c_w:")))


def test_a_vehicle_that_is_not_valid_leaves_the_file_as_it_is(car):
    vehicle = load_vehicle(car(GOOD))
    written = car("").with_name("written.yaml")
    write_vehicle(written, vehicle)
    before = written.read_text()
    with pytest.raises(InputError, match=r"written\.yaml:\d+: vehicle file, beta"):
        write_vehicle(written, replace(vehicle, beta=1.0))
    assert written.read_text() == before


@pytest.mark.parametrize("folder", ["", "../cars", "below/.."])
def test_a_written_vehicle_names_its_profile_where_that_is_beside(car, folder):
    """By a path from the file, for no other is read; else in words."""
    path = car(GOOD + "can_profile: own.yaml\n")
    profile, written = path.with_name("own.yaml"), path.parent / folder / "written.yaml"
    (path.parent / "below").mkdir()
    write_vehicle(written, load_vehicle(path))
    elsewhere = folder == "../cars"
    assert (load_vehicle(written).can_profile is None) == elsewhere
    if elsewhere:
        assert written.read_text().startswith(f"# Not beside this file: --can-profile {profile}\n")
    else:
        assert Path(load_vehicle(written).can_profile).resolve() == profile


CORRELATED = GOOD + "correlations: {source: a sheet, mass: {c_rr: 0.2, c_d: -0.5}}\n"


def test_correlations_of_parameters(car):
    vehicle = load_vehicle(car(CORRELATED))
    assert vehicle.correlations == {("mass", "c_rr"): 0.2, ("mass", "c_d"): -0.5}
    mass, c_d = PARAMETER_NAMES.index("mass"), PARAMETER_NAMES.index("c_d")
    assert vehicle.correlation[mass, c_d] == vehicle.correlation[c_d, mass] == -0.5
    assert (load_vehicle(car(GOOD)).correlation == np.eye(6)).all()
    write_vehicle(car("").with_name("b.yaml"), vehicle)
    assert load_vehicle(car("").with_name("b.yaml")).correlations == vehicle.correlations


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("c_rr: 0.2", "c_rr: 0.9", "correlations is not positive definite"),
        ("c_rr: 0.2", "c_rr: 1.2", "outside [-1, 1]"),
        ("c_rr: 0.2", "eta: 0.2", "unknown key 'eta'; known are c_rr, c_d, p_aux"),
        ("source: a sheet, mass", "mass", "'source' is missing"),
    ],
)
def test_correlations_that_cannot_be(car, old, new, reason):
    with pytest.raises(InputError) as refused:
        load_vehicle(car(CORRELATED.replace(old, new)))
    assert ":14: " in str(refused.value) and reason in str(refused.value), str(refused.value)
