"""Situations that users reported: the right answer, or what is assumed, or a refusal."""

from collections.abc import Callable
import math
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from exports import Drive, date, measured, opened, simulated, table

from evpinn_ros.common.errors import InputError
from evpinn_ros.logs.sources import open_drive

DRIVE = simulated()
PLAIN = "time,Speed (km/h),HV Battery Voltage (V),HV Battery Current (A)"


def plain(t, v, u, i, *_):
    return f"{date(t)},{3.6 * v:.2f},{u:.2f},{i:.2f}"


def written(header: str, line: str, drive: Drive = DRIVE) -> str:
    """A table of lines in which quantities stand by their units."""
    return table(
        header,
        drive,
        lambda t, v, u, i, far, soc: line.format(
            t=t, date=date(t), mps=v, kmh=3.6 * v, mph=v / 0.44704, volts=u, amps=i, watts=u * i,
            kw=u * i / 1000, km=far / 1000, miles=far / 1609.344, soc=soc, epoch=1709622489 + t,
            minutes=(t + 1000) / 60, minute=int(t + 17) // 60,
            ticks=638452 * 10**12 + int(t) * 10**7, size=abs(i), one_way=max(i, 0.0),
            offset=i + 500, tenths=36 * v, limited=250.0 if i > 30 else 1.0,
        ),
    )  # fmt: skip


MILES = (
    "timestamp,speed,odometer,soc,elevation,power,shift_state",
    "{epoch:.0f}000,{mph:.1f},{miles:.2f},{soc:.0f},1,{kw:.2f},D",
)
STAMPS_OF_A_MINUTE = (
    "Time_Stamp,vehicle_speed,Odometer,DC_Link_Voltage,DC_Link_Current",
    "12/17/2024 10:{minute:02d},{kmh:.1f},{km:.1f},{volts:.2f},{amps:.2f}",
)
LEAFSPY = (
    "Date/Time,Speed,Gids,Pack Volts,Pack Amps,Odo(km),epoch time, Speed1, Speed2",
    "{date},{mph:.2f},400,{volts:.2f},{amps:.3f},{km:.2f},{epoch:.0f},0,0",
)


def clock(seconds: float) -> str:
    return date(seconds)[11:].replace(":", "")


def decimal_comma():
    return table(PLAIN, DRIVE, lambda t, *v: plain(t, *v).replace(".", ","))


def thousands():
    header = f"time,Odometer (km),{PLAIN[5:]}"
    return table(
        header,
        DRIVE,
        lambda t, v, u, i, far, _: (
            f"{date(t)},{(far - 28_582_000) / 1000 + 997.5:,.1f},{3.6 * v:.2f},{u:.2f},{i:.2f}"
        ),
    )


def three_decimals_and_a_torn_row():
    """A cell that the tear left whole is none of thousands: the commas of others are decimal."""
    lines = table(
        PLAIN,
        DRIVE,
        lambda t, v, u, i, *_: f"{date(t)};{3.6 * v:.3f};{u:.3f};{i:.3f}".replace(".", ","),
    ).splitlines()
    lines[0] = PLAIN.replace(",", ";")
    lines[300] = ";".join([*lines[300].split(";")[:2], "360"])
    return "\n".join(lines)


def dst(first: str, hours: int, at: int = 480) -> str:
    """The clock of a local time that is set by so many hours on a minute of the drive."""
    lines = table(PLAIN, DRIVE, plain).splitlines()

    def line(k: int, text: str) -> str:
        day, _, _ = first.partition(" ")
        hour = int(first[11:13]) * 3600 + 52 * 60 + k + (3600 * hours if k >= at else 0)
        clock = f"{day} {hour // 3600:02d}:{hour // 60 % 60:02d}:{hour % 60:02d}"
        return ",".join([clock, *text.split(",")[1:]])

    return "\n".join([lines[0], *(line(k, text) for k, text in enumerate(lines[1:]))])


def in_another_zone(hours: int) -> str:
    """Dates of a telephone that is in another time zone for five minutes."""

    def line(t, *values):
        moment = date(t + 3600 * hours * (300 <= t < 600))
        return plain(t, *values).replace(date(t), moment)

    return table(PLAIN, DRIVE, line)


def repeated_with_power():
    """Rows three times, with power beside voltage and current."""
    line = "{t:.1f},{kmh:.2f},{volts:.2f},{amps:.2f},{watts:.1f}"
    text = written("time,speed_kmh,voltage,current,power", line)
    lines = text.splitlines()
    return "\n".join([lines[0], *(line for line in lines[1:] for _ in range(3))])


RIGHT: dict[str, tuple[Callable[[], str], str]] = {
    "decimal comma as separator": (decimal_comma, ""),
    "thousands": (thousands, ""),
    "mph and miles": (
        lambda: written(*MILES),
        "'speed' is assumed to be in mph, and could be in km/h",
    ),
    "stamps of a minute": (lambda: written(*STAMPS_OF_A_MINUTE), "a resolution of 60 s"),
    "three decimals and a torn row": (three_decimals_and_a_torn_row, ""),
    "autumn": (lambda: dst("2024-10-27 02", -1), ""),
    "spring": (lambda: dst("2024-03-31 01", 1), ""),
    "two hours back and forth": (lambda: in_another_zone(-2), "rows are not in order of time"),
    "two hours forth and back": (lambda: in_another_zone(2), "rows are not in order of time"),
    "LeafSpy without Speed2": (lambda: written(*LEAFSPY), ""),
    "rows repeated": (repeated_with_power, ""),
}


@pytest.mark.parametrize("case", RIGHT)
def test_way_and_energy_are_right(tmp_path, case):
    text, note = RIGHT[case]
    source = opened(tmp_path, text())
    distance, energy = measured(source)
    assert distance == pytest.approx(DRIVE.distance, rel=0.01)
    assert energy == pytest.approx(DRIVE.energy, rel=0.01)
    assert note in " ".join(source.notes) and not (note == "" and "assumed to be" in note)


def test_minutes_and_seconds_can_be_given_where_hours_and_minutes_are_assumed(tmp_path):
    text = table(
        PLAIN, DRIVE, lambda t, *v: plain(t, *v).replace(date(t), date(t)[14:].lstrip("0"))
    )
    notes = " ".join(opened(tmp_path, text).notes)
    assert "--column 'time=time:%M:%S'" in notes
    source = opened(tmp_path, text, columns=["time=time:%M:%S"])
    assert measured(source)[0] == pytest.approx(DRIVE.distance, rel=0.01)
    assert "assumed" not in " ".join(source.notes)


MASSES, VOLTS = (200, 250, 700, 1900, 700, 250, 700, 9000), (20, 60, 48, 48, 100, 350, 350, 600)


@pytest.mark.parametrize(("mass", "volts"), [*zip(MASSES, VOLTS, strict=True)])
@pytest.mark.parametrize("odometer", ["", ",{miles:.2f}"])
def test_a_speed_in_mph_is_read_so_or_the_unit_is_assumed(tmp_path, mass, volts, odometer):
    drive = simulated(mass=mass, volts=volts)
    header = "time,speed,voltage,current" + (odometer and ",odometer")
    source = opened(
        tmp_path, written(header, "{t},{mph:.2f},{volts:.3f},{amps:.3f}" + odometer, drive)
    )
    is_right = measured(source)[0] == pytest.approx(drive.distance, rel=0.02)
    assert is_right or "'speed' is assumed to be in" in " ".join(source.notes)


@pytest.mark.parametrize("header", ["t_s,speed_mps,voltage_v,current_a", "t,v veh,Volt,Amps"])
@pytest.mark.parametrize("current", [0, 7])
def test_a_current_that_never_changes_is_not_measured(tmp_path, header, current):
    text = table(header, DRIVE, lambda t, v, u, *_: f"{t},{v:.2f},{u:.2f},{current}")
    source = opened(tmp_path, text)
    assert math.isnan(measured(source)[1])
    assert f"current is always {current} A while the car speeds up" in " ".join(source.notes)
    assert not any("flows back" in note for note in source.notes)


def test_the_voltage_of_12_volts_is_not_that_of_the_traction_battery(tmp_path):
    def line(t, v, _, i, *__):
        return f"{t},{3.6 * v:.2f},{13.8 + 0.1 * math.sin(t):.1f},{i:.2f}"

    header = "time,Speed (km/h),Battery Voltage (V),HV Battery Current (A)"
    source = opened(tmp_path, table(header, DRIVE, line))
    assert math.isnan(measured(source)[1])
    assert "voltage is about 13.8 V whatever the current" in " ".join(source.notes)


@pytest.mark.parametrize("unit", [0.1, 0.05, 0.02, 0.01])
@pytest.mark.parametrize("bits", [16, 32])
def test_an_unsigned_current_is_signed(tmp_path, unit, bits):
    span = unit * 2**bits
    text = table(
        PLAIN, DRIVE, lambda t, v, u, i, *_: f"{date(t)},{3.6 * v:.2f},{u:.2f},{i % span:.3f}"
    )
    source = opened(tmp_path, text)
    assert measured(source)[1] == pytest.approx(DRIVE.energy, rel=0.01)
    assert f"numbers above {span / 2:g} are negative" in " ".join(source.notes)


def test_a_current_without_its_sign_is_told(tmp_path):
    line = "{date},{kmh:.2f},{volts:.2f},"
    text = written(PLAIN, line + "{size:.2f}")
    assert "has lost its sign" in " ".join(opened(tmp_path, text).notes)
    text = written(PLAIN, line + "{one_way:.2f}")
    assert "no current ever flows back" in " ".join(opened(tmp_path, text).notes)


DECOYS = ("DC-DC {}", "{} RMS", "{} Offset", "{} Error", "Previous {}", "12V {}", "Charger {}")


@pytest.mark.parametrize("name", ["Battery Current (A)", "Speed (km/h)", "HV Battery Voltage (V)"])
def test_a_column_of_something_else_loses(tmp_path, name):
    names = ["time", *(decoy.format(name) for decoy in DECOYS), *PLAIN.split(",")[1:]]
    names[-1] = "Battery Current (A)"
    text = table(
        ",".join(names),
        DRIVE,
        lambda t, *v: plain(t, *v).replace(",", ",77" * len(DECOYS) + ",", 1),
    )
    distance, energy = measured(opened(tmp_path, text))
    assert (distance, energy) == pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)


def test_a_twin_can_be_chosen(tmp_path):
    header = "time,Speed (km/h),Speed (km/h),Voltage (V),Current (A)"
    text = table(
        header, DRIVE, lambda t, v, u, i, *_: f"{date(t)},{v:.2f},{3.6 * v:.2f},{u:.2f},{i:.2f}"
    )
    source = opened(tmp_path, text, columns=["speed=Speed (km/h) #2"])
    assert measured(source)[0] == pytest.approx(DRIVE.distance, rel=0.01)


@pytest.mark.parametrize("form", ["wide", "long"])
def test_a_second_header_is_followed_in_the_rows_of_a_car(tmp_path, form):
    """It has another order, that of the column that names the car too."""
    names = f"car,{PLAIN}".split(",")
    cars = {"A7": DRIVE, "B2": simulated(seed=1)}
    rows = []
    for car, drive in cars.items():
        lines = table("", drive, lambda *v, car=car: f"{car},{plain(*v)}").splitlines()[1:]
        rows.append([line.split(",") for line in lines])
    if form == "long":
        signals = names[2:]
        rows = [
            [
                [car, time, name, value]
                for car, time, *values in of_car
                for name, value in zip(signals, values, strict=True)
            ]
            for of_car in rows
        ]
        names = ["car", "time", "name", "value"]
    blocks = []
    for half, turn in ((0, 0), (1, 2)):
        order = [*range(turn, len(names)), *range(turn)]
        parts = [row for of_car in rows for row in of_car[half::2]]
        blocks += [[row[at] for at in order] for row in [names, *parts]]
    text = "\n".join(map(",".join, blocks))
    for car, drive in cars.items():
        source = opened(tmp_path, text, car=car)
        expected = (drive.distance, drive.energy)
        assert measured(source) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("ambient", "celsius", "basis"), [(59, 15.0, "measured"), (20, -6.7, "assumed")]
)
def test_leafspy_has_an_ambient_temperature_of_a_unit_that_is_set(
    tmp_path, ambient, celsius, basis
):
    header, line = LEAFSPY
    source = opened(tmp_path, written(f"{header},Ambient", f"{line},{ambient}"))
    (rule,) = (rule for rule in source.rules if rule.quantity == "ambient")
    assert rule.basis == basis and rule.factor * ambient + rule.offset == pytest.approx(
        celsius, abs=0.1
    )
    assert ("'Ambient' is assumed to be in f, and could be in c" in " ".join(source.notes)) == (
        basis == "assumed"
    )


def with_engine(turns):
    def line(t, v, u, i, *_):
        return f"{plain(t, v, u, i)},{turns(t, v):.0f}"

    return table(f"{PLAIN},Engine RPM (rpm)", DRIVE, line)


def test_a_hybrid_is_read_where_its_engine_stands(tmp_path):
    source = opened(tmp_path, with_engine(lambda t, v: 1500 + 30 * v if t >= 450 else 0))
    stamps = [reading.stamp_ns for reading in source.readings()]
    assert (max(stamps) - min(stamps)) / 1e9 == 449 and source.dropped == {"engine_on": 450}
    assert "rows in which the combustion engine runs are not used" in source.notes
    motor = opened(tmp_path, with_engine(lambda t, v: 410 * v))
    assert measured(motor)[0] == pytest.approx(DRIVE.distance, rel=0.01) and not motor.dropped


def test_the_visible_sheet_with_a_drive_is_read_and_others_are_named(tmp_path):
    book = pytest.importorskip("openpyxl").Workbook()
    hidden = book.active
    hidden.title, hidden.sheet_state = "old", "hidden"
    lines = [line.split(",") for line in table(PLAIN, DRIVE, plain).splitlines()]
    for title, rows in (
        ("notes", [["a", "b"], [1, 2]]),
        ("drive", lines[:500]),
        ("drive 2", [lines[0], *lines[500:]]),
    ):
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    for row in lines[:10]:
        hidden.append(row)
    book.save(tmp_path / "drive.xlsx")
    source = open_drive(tmp_path / "drive.xlsx")
    assert measured(source)[0] == pytest.approx(DRIVE.distance, rel=0.01)
    assert "sheets that are not read: notes" in source.notes


REFUSED = {
    "three decimals or thousands": (
        lambda: table(
            "time,Speed (km/h),Voltage (V),Current (A)",
            DRIVE,
            lambda t, v, u, i, *_: (
                f"{t:.0f},{3.6 * v:.3f},,".replace(".", ",")
                + f"\n{t:.0f},,{u:.3f},".replace(".", ",")
                + f"\n{t:.0f},,,{i:.3f}".replace(".", ",")
            ),
        ),
        r"row \d+ has 5 cells under 4 names .*save the table with semicolons",
    ),
    "blanks": (
        lambda: table(PLAIN, DRIVE, plain).replace(" ", "_").replace(",", " "),
        r"one column, 'time Speed_.* not by blanks",
    ),
    "another unit below": (
        lambda: (
            table(PLAIN, DRIVE, plain)
            + table(PLAIN.replace("(A)", "(mA)"), DRIVE, lambda t, *v: plain(t + 1000, *v))
        ),
        r"drive.csv: row 902 is another header, without 'HV Battery Current \(A\)'",
    ),
    "a clock without colons": (
        lambda: table(PLAIN, DRIVE, lambda t, *v: plain(t, *v).replace(date(t), clock(t))),
        r"column 'time': '070809' is in no known format of time; say --column time=NAME",
    ),
    "ticks of 100 ns": (
        lambda: written(PLAIN, "{ticks:.0f},{kmh:.2f},{volts:.2f},{amps:.2f}"),
        r"column 'time': '638452000000000000' is in no known format of time",
    ),
    "commas of whole numbers": (
        lambda: table(
            "time,rpm,load,Speed (km/h),Voltage (V),Current (A)",
            DRIVE,
            lambda t, v, u, i, *_: (
                f"{t:.0f},{400 + 99 * v:,.0f},{700 + 9 * i:,.0f},{100 + v:.0f},{u:.0f},{i:.0f}"
            ),
        ),
        r"drive.csv: row \d+ has 7 cells under 6 names .*save the table with semicolons",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_names_the_row_and_the_remedy(tmp_path, case):
    text, message = REFUSED[case]
    with pytest.raises(InputError, match=message):
        opened(tmp_path, text())


def test_a_clock_without_colons_can_be_given(tmp_path):
    text = table(PLAIN, DRIVE, lambda t, *v: plain(t, *v).replace(date(t), clock(t)))
    source = opened(tmp_path, text, columns=["time=time:%H%M%S"])
    assert measured(source) == pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)


def two_cars_without_a_name():
    pairs = zip(
        table("", DRIVE, plain).splitlines()[1:],
        table("", simulated(seed=1), plain).splitlines()[1:],
        strict=True,
    )
    return "\n".join([PLAIN, *(line for pair in pairs for line in pair)])


TOLD: dict[str, tuple[Callable[[], str], str]] = {
    "two cars without a name": (two_cars_without_a_name, "as no car does, so doubt all totals"),
    "two packs": (
        lambda: written(
            "t_s,Speed (km/h),Pack Voltage (V),Pack 1 Current (A),Pack 2 Current (A)",
            "{t},{kmh:.2f},{volts:.2f},{amps:.2f},{amps:.2f}",
        ),
        "assumed to be that of the whole battery; not counted: Pack 2 Current (A)",
    ),
    "an offset": (
        lambda: written(PLAIN, "{date},{kmh:.2f},{volts:.2f},{offset:.2f}"),
        "kW while the car stands: the current has an offset",
    ),
    "discharging alone": (
        lambda: written(PLAIN, "{date},{kmh:.2f},{volts:.2f},{one_way:.2f}"),
        "if the car regenerates, every energy is too large",
    ),
    "tenths of km/h": (
        lambda: written("time,speed,voltage,current", "{t},{tenths:.0f},{volts:.2f},{amps:.2f}"),
        "'speed' is assumed to be in",
    ),
}


@pytest.mark.parametrize("case", TOLD)
def test_what_cannot_be_right_is_told(tmp_path, case):
    text, note = TOLD[case]
    source = opened(tmp_path, text())
    list(source.readings())
    assert note in " ".join(source.notes)


@pytest.mark.parametrize("bits", [10, 12, 15])
def test_an_unsigned_current_of_few_bits_is_signed_where_it_comes_of_braking(tmp_path, bits):
    span = float(2**bits)
    text = table(
        PLAIN, DRIVE, lambda t, v, u, i, *_: f"{date(t)},{3.6 * v:.2f},{u:.2f},{i % span:.2f}"
    )
    assert measured(opened(tmp_path, text))[1] == pytest.approx(DRIVE.energy, rel=0.01)
    limited = written(PLAIN, "{date},{kmh:.2f},{volts:.2f},{limited:.1f}")
    assert "wraps: numbers above" not in " ".join(opened(tmp_path, limited).notes)


@pytest.mark.parametrize("largest", [70.0, 100.0, 127.0])
def test_an_unsigned_byte_of_power_is_signed(tmp_path, largest):
    """Powers up to any share of its range."""
    scale = largest / float(np.max(DRIVE.voltage * DRIVE.current))
    text = table(
        "time,Speed (km/h),Power (kW)",
        DRIVE,
        lambda t, v, u, i, *_: f"{date(t)},{3.6 * v:.2f},{round(scale * u * i) % 256}",
    )
    source = opened(tmp_path, text)
    assert measured(source)[1] == pytest.approx(1e3 * scale * DRIVE.energy, rel=0.02)
    assert "numbers above 128 are negative" in " ".join(source.notes)


@pytest.mark.parametrize("known", ["km/h", "mph", "m/s"])
def test_positions_tell_the_unit_of_a_speed(tmp_path, known):
    factor = {"km/h": 3.6, "mph": 1 / 0.44704, "m/s": 1.0}[known]
    text = table(
        "t,speed,voltage,current,lat,lon",
        DRIVE,
        lambda t, v, u, i, far, _: (
            f"{t:.0f},{factor * v:.2f},{u:.1f},{i:.2f},{48 + np.degrees(far / 6.371e6):.6f},11.5"
        ),
    )
    source = opened(tmp_path, text)
    assert measured(source)[0] == pytest.approx(DRIVE.distance, rel=0.01)
    (speed,) = (rule for rule in source.rules if rule.quantity == "speed")
    assert (speed.unit, speed.why, speed.could_be) == (known, "by the positions", ())
