"""Rows that an app writes at once are one reading, in every table."""

import json
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from exports import Drive, measured, opened, simulated

DRIVE = simulated(count=300, step=0.6, mass=250.0, volts=84.0, seed=3)
NAMES = "time (s)", "speed (km/h)", "voltage (V)", "current (A)"
NOTE = "rows written in one burst are one reading, of their last values"


def signals(drive: Drive = DRIVE) -> np.ndarray:
    return np.round(np.array([drive.time, 3.6 * drive.speed, drive.voltage, drive.current]), 3).T


def bursts(kind: str, spread: float = 0.02) -> np.ndarray:
    """Two or three rows each 0.6 s."""
    chance = np.random.default_rng(1)
    rows, last = [], signals()[0]
    for row in signals():
        count = int(chance.integers(2, 4))
        for i in range(count):
            written = row.copy()
            written[0] += spread * i / (count - 1)
            if kind == "part by part":  # each row tells one more signal
                written[1 + i + 1 :] = last[1 + i + 1 :] if i + 1 < count else row[1 + i + 1 :]
            elif kind == "two packs":
                written[3] *= chance.normal(0.5, 0.02)
            elif kind == "one signal a row":
                written[[place for place in (1, 2, 3) if place % count != i]] = np.nan
            rows.append(written)
        last = row
    return np.round(rows, 3)


def csv(rows: np.ndarray) -> str:
    cells = [["" if np.isnan(value) else f"{value:.3f}" for value in row] for row in rows]
    return "\n".join(map(",".join, [NAMES, *cells])) + "\n"


def as_json(rows: np.ndarray) -> str:
    told = [{k: v for k, v in zip(NAMES, row, strict=True) if v == v} for row in rows.tolist()]
    return json.dumps({"samples": told})


def as_long(rows: np.ndarray) -> str:
    cells = [
        f"{row[0]:.3f},{name},{value}"
        for row in rows
        for name, value in zip(NAMES[1:], row[1:], strict=True)
        if value == value
    ]
    return "\n".join(["time (s),name,value", *cells]) + "\n"


FORMS = {"drive.csv": csv, "drive.json": as_json, "long.csv": as_long}


@pytest.mark.parametrize("spread", [0.0, 0.02, 0.08])
@pytest.mark.parametrize("kind", ["repeated", "part by part", "one signal a row"])
@pytest.mark.parametrize("name", FORMS)
def test_a_burst_is_one_reading(tmp_path, name, kind, spread):
    source = opened(tmp_path, FORMS[name](bursts(kind, spread)), name)
    distance, energy = measured(source)
    assert source.used == DRIVE.time.size
    assert (NOTE in source.notes) == (name != "long.csv")
    assert (distance, energy) == pytest.approx((DRIVE.distance, DRIVE.energy), rel=2e-3)


def regular(step: float) -> np.ndarray:
    return signals(simulated(count=600, step=step, mass=250.0, volts=84.0, seed=3))


@pytest.mark.parametrize(
    "rows",
    [regular(0.05), np.repeat(regular(1.0)[:19], 3, axis=0), bursts("two packs")],
    ids=["20 Hz", "few", "two packs that take turns"],
)
def test_other_rows_are_readings(tmp_path, rows):
    assert NOTE not in opened(tmp_path, csv(rows)).notes
