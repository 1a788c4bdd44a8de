import math

import pytest

from benchmarks.battery_end import battery_rows
from benchmarks.logs import find_logs

pytestmark = pytest.mark.slow

FULL, RESISTANCE = 55.0 * 3600, 0.15  # A s, Ohm


def write(path, charge, seconds):
    """A drive of a battery whose voltage falls by 60 V from full to empty; its last charge."""
    rows = ["t_s,speed_mps,voltage_v,current_a,soc_pct"]
    for second in range(seconds):
        current = 60.0 + 50.0 * math.sin(second / 9)
        charge -= current / FULL
        voltage = 350.0 + 60.0 * (charge - 0.5) - RESISTANCE * current
        rows.append(f"{second},10.0,{voltage:.3f},{current:.3f},{100 * charge:.3f}")
    path.write_text("\n".join(rows))
    return charge


def test_the_state_of_the_battery_beside_energy_over_capacity(tmp_path):
    """Learned at a high charge, asked at a low one, where a kilowatt-hour takes more of it."""
    charge = write(tmp_path / "a.csv", 0.95, 1500)
    write(tmp_path / "b.csv", charge - 0.25, 600)
    first, second = (row for _, row in battery_rows(find_logs(str(tmp_path), "bmw_i3")))
    assert first.by_state is None and first.voltage_by_state is None
    assert second.used == pytest.approx(600 * 60 / FULL, rel=0.1)
    assert abs(second.by_state) < 0.25 * abs(second.by_capacity)
    assert abs(second.voltage_by_state) < 0.25 * abs(second.voltage_held)
