"""What a file says against itself is said to its owner."""

import pytest

from evpinn_ros.drives.sources import open_drive
from test.drives.test_columns import drive_of, rows

OURS = "t_s,speed_mps,voltage_v,current_a"


def lines(*, current: float = 1.0, power: float | None = None):
    """Rows of `OURS`, current and a fifth column of power times a factor each."""
    for t, v, u, i in rows():
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
    assert open_drive(tmp_path / "drive.csv", columns=[turned]).notes == ()


@pytest.mark.parametrize("name", ["power_w", "Battery Power (W)"])
@pytest.mark.parametrize(
    ("factor", "said"), [(-1.0, "has the other sign than"), (0.001, "is 0.001 times")]
)
def test_power_is_compared_with_voltage_times_current(tmp_path, name, factor, said):
    (note,) = drive_of(tmp_path, f"{OURS},{name}", lines(power=factor)).notes
    assert repr(name) in note and said in note


def test_the_power_of_a_heater_is_not_that_of_the_battery(tmp_path):
    heated = (f"{line},{7 * (number % 3)}" for number, line in enumerate(lines()))
    assert drive_of(tmp_path, f"{OURS},Air Conditioning Power[Watts]", heated).notes == ()
