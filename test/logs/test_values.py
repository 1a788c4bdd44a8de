"""Units, repeated cells and contradictions, as values of columns tell them."""

import numpy as np
import pytest

from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.logs.column import column_of
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_drive
from evpinn_ros.logs.values import Signal, held_columns, of_12_volts
from test.logs.test_columns import drive_of, rows

OURS = "t_s,speed_mps,voltage_v,current_a"


def lines(*, current: float = 1.0, power: float | None = None):
    """Rows of `OURS`, current and a fifth column of power times a factor each."""
    for t, v, volts, i in rows():
        u = round(volts - 0.05 * i, 3)  # a battery falls under its load
        more = "" if power is None else f",{power * u * i:.1f}"
        yield f"{t:.1f},{v:.4f},{u},{current * i:.4f}{more}"


def test_a_sound_file_is_not_contradicted(tmp_path):
    assert drive_of(tmp_path, OURS, lines()).notes == ()
    assert drive_of(tmp_path, f"{OURS},power_w", lines(power=1.0)).notes == ()


def test_a_car_that_speeds_up_while_it_charges_has_a_current_of_the_wrong_sign(tmp_path):
    drive = drive_of(tmp_path, OURS, lines(current=-1.0))
    (note,) = drive.notes
    assert "speeds up while its battery is charged" in note
    turned = note.partition("--column '")[2].partition("'")[0]
    assert open_drive(tmp_path / "drive.csv", options=ReadOptions(columns=[turned])).notes == ()


@pytest.mark.parametrize("name", ["power_w", "Battery Power (W)"])
@pytest.mark.parametrize(
    ("factor", "said"), [(-1.0, "has the opposite sign of"), (0.001, "is 0.001 times")]
)
def test_power_is_compared_with_voltage_times_current(tmp_path, name, factor, said):
    (note,) = drive_of(tmp_path, f"{OURS},{name}", lines(power=factor)).notes
    assert repr(name) in note and said in note


def test_the_power_of_a_heater_is_not_that_of_the_battery(tmp_path):
    heated = (f"{line},{7 * (number % 3)}" for number, line in enumerate(lines()))
    assert drive_of(tmp_path, f"{OURS},Air Conditioning Power[Watts]", heated).notes == ()


def speed_at(time):
    """Speed in town, km/h."""
    return 27.0 - 27.0 * np.cos(time / 7.0)


def write_log(path, *, held: bool):
    """Write a speed each second and a voltage in between; the rest filled forward, or empty."""
    lines, last = ["time,Speed (km/h),HV Voltage (V),HV Current (A)"], ""
    for second in range(600):
        last = f"{speed_at(second):.4f}"
        current = f"{40.0 * np.sin(second / 7.0) + 20.0:.3f}"
        lines.append(f"{second:.2f},{last},360,{current}")
        lines.append(f"{second + 0.8:.2f},{last if held else ''},361,{current if held else ''}")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_speed_that_was_filled_forward_is_taken_once(tmp_path):
    signals = []
    for held in (True, False):
        drive = open_drive(write_log(tmp_path / f"{held}.csv", held=held))
        readings = list(drive.readings())
        speeds = [(r.stamp_ns, r.speed) for r in readings if isinstance(r, SpeedReading)]
        amps = [r.current for r in readings if isinstance(r, BatteryReading)]
        signals.append((speeds, [current for current in amps if current == current]))
        assert ("repeat the last value" in " ".join(drive.notes)) == held
    assert signals[0] == signals[1] and len(signals[0][0]) == 600


@pytest.mark.parametrize("step", [0.1, 1.0])
def test_an_even_log_keeps_its_repeats(step):
    time = np.arange(0.0, 300.0, step)
    held = speed_at(np.floor(time / (2 * step)) * 2 * step)
    assert not held_columns({"speed": Signal(time, held)})


def test_whole_kilometres_an_hour_repeat_by_themselves():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.choice([0.1, 0.8, 1.1], 800))
    assert held_columns({"speed": Signal(time, np.repeat(speed_at(time[::2]), 2))})
    assert not held_columns({"speed": Signal(time, np.repeat(speed_at(time[::2]).round(), 2))})


@pytest.mark.parametrize("places", [[], [50], range(40)], ids=len)
def test_a_current_of_nothing_says_nothing_of_the_voltage(places):
    """Cells that are all missing have no swing, of which numpy says so by an error."""
    header = ["Voltage (V)", "Current (A)"]
    columns = {name.split()[0].lower(): name for name in header}
    columns = {key: column_of(key, header, header.index(columns[key])) for key in columns}
    amperes = np.full(100, np.nan)
    amperes[places] = 3.0
    for volts in (np.full(100, 12.5), np.full(100, np.nan)):
        cells = {"voltage": Signal(np.arange(100.0), volts)}
        cells["current"] = Signal(np.arange(100.0), amperes)
        assert of_12_volts(columns, cells) == ""
