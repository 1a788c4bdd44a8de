"""Which column is what where several could be, and units that a name spells."""

import json
from pathlib import Path
import sys

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from exports import START, measured, opened, simulated, table

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import AuxiliaryReading, TemperatureReading
from evpinn_ros.logs.column import columns_by_name

DRIVE = simulated()
SIGNALS = [column.tolist() for column in (DRIVE.time, DRIVE.speed, DRIVE.voltage, DRIVE.current)]
LIGHT = simulated(mass=110.0, volts=84.0)
RIGHT = pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)


def rule(source, quantity):
    (column,) = (column for column in source.rules if column.quantity == quantity)
    return column


# The app computes it from the measured one: it rises where the measured one falls.
COMPUTED = ("battery_corrected_voltage", "Pack compensated voltage", "HV open circuit voltage")


@pytest.mark.parametrize("name", [*COMPUTED, "estimated pack voltage"])
@pytest.mark.parametrize("first", [True, False])
def test_a_measured_voltage_is_used_before_a_computed_one(tmp_path, name, first):
    names = [name, "voltage"] if first else ["voltage", name]

    def line(t, v, u, i, *_):
        cells = {name: f"{84.0 + 0.01 * i:.2f}", "voltage": f"{u:.2f}"}
        cells_of_names = ",".join(cells[column] for column in names)
        return f"{t:.0f},{3.6 * v:.2f},{cells_of_names},{i:.2f}"

    source = opened(
        tmp_path, table(f"time (s),speed (km/h),{','.join(names)},current", LIGHT, line)
    )
    assert rule(source, "voltage").name == "voltage"
    assert measured(source) == pytest.approx((LIGHT.distance, LIGHT.energy), rel=0.01)


@pytest.mark.parametrize(("sign", "opposite"), [(1, "-a"), (-1, "a")])
def test_accelerating_decides_the_sign_where_a_computed_voltage_says_otherwise(
    tmp_path, sign, opposite
):
    def line(t, v, _, i, *__):
        return f"{t:.0f},{3.6 * v:.2f},{84.0 + 0.01 * i:.3f},{sign * i:.2f},{84 * i:.0f}"

    header = "time (s),speed (km/h),battery_corrected_voltage,current,power"
    source = opened(tmp_path, table(header, LIGHT, line))
    assert measured(source)[1] == pytest.approx(LIGHT.energy, rel=0.02)
    assumed = f"the sign of 'current' is assumed; --column 'current=current:{opposite}' turns it"
    assert " ".join(source.notes).count(assumed) == 1
    turned = opened(tmp_path, source.path.read_text(), columns=[f"current=current:{opposite}"])
    assert rule(turned, "current").factor == -sign


@pytest.mark.parametrize("sign", ["", "-"])
def test_a_power_whose_unit_is_assumed_says_so(tmp_path, sign):
    """It said that the sign was assumed, and that `:w` turns it."""

    def line(t, v, u, i, *_):
        return f"{t:.0f},{3.6 * v:.2f},{float(f'{sign}1') * 8e-3 * u * i:.2f}"

    source = opened(tmp_path, table("time (s),speed (km/h),Battery Power", DRIVE, line))
    measured(source)
    notes = " ".join(source.notes)
    assert "'Battery Power' is assumed to be in kw, and could be in w; --column" in notes
    assert f"Battery Power:{sign}w' sets that" in notes and "the sign" not in notes


@pytest.mark.parametrize("clock", ["ms_today", "Time (s)", "elapsed_ms"])
def test_energies_and_charges_are_no_times(tmp_path, clock):
    counters = "watt_hours_used,amp_hours_used,Wh per hour,kWh time,Ah hours"

    def line(t, v, u, i, *_):
        stamp = t if clock == "Time (s)" else 1000 * (t + 60_000)
        counts = f"{t / 50:.4f},{t / 99:.4f},{t / 7:.4f},{t / 8:.4f},{t}"
        return f"{counts},{stamp:.0f},{v:.2f},{u:.2f},{i:.2f}"

    header = f"{counters},{clock},speed (m/s),pack volts,pack amps"
    source = opened(tmp_path, table(header, DRIVE, line))
    assert rule(source, "time").name == clock
    assert measured(source) == RIGHT


SPELLED = {
    "speed_meters_per_sec": 1.0, "SpeedMetersPerSecond": 1.0, "vehicle_speed_m_per_s": 1.0,
    "speed_kilometers_per_hour": 3.6, "speed_km_per_h_raw": 3.6, "kmh_vehicle_speed": 3.6,
    "speed_mph_obd": 1 / 0.44704, "speed_miles_per_hour": 1 / 0.44704,
}  # fmt: skip


@pytest.mark.parametrize("name", SPELLED)
def test_a_unit_that_is_spelled_in_a_name_is_used(tmp_path, name):
    """A slow one, whose values alone would be another unit."""

    def line(t, v, u, i, *_):
        return f"{t:.0f},{SPELLED[name] * v:.3f},{u:.2f},{i:.2f}"

    source = opened(tmp_path, table(f"time (s),{name},pack volts,pack amps", DRIVE, line))
    assert rule(source, "speed").basis == "named"
    assert measured(source) == RIGHT


def test_the_current_of_all_controllers_is_that_of_the_battery(tmp_path):
    """The VESC Tool logs one of two controllers, and the sums of both."""
    header = (
        "ms_today;input_voltage;current_motor;current_in;amp_hours_used;watt_hours_used;vesc_id;"
        "ms_today_setup;battery_level;current_in_setup;current_motor_setup;speed_meters_per_sec;"
        "num_vescs"
    )

    def line(t, v, u, i, _, soc):
        return (
            f"{62166050 + 1000 * t:.0f};{u:.2f};{i:.2f};{i / 2:.3f};{t / 90:.4f};{t / 9:.4f};1;"
            f"{62166050 + 1000 * t:.0f};{soc / 100:.4f};{i:.3f};{2 * i:.2f};{v:.3f};2"
        )

    source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source) == RIGHT
    assert (rule(source, "time").unit, rule(source, "charge").unit) == ("ms", "fraction")


@pytest.mark.parametrize(
    ("name", "factor"), [("soc", 1), ("charge_pct", 1), ("SOC", 0.01), ("battery_percent", 1)]
)
def test_a_charge_beside_our_names_is_read(tmp_path, name, factor):
    def line(t, v, u, i, _, soc):
        return f"{t:.0f},{v:.3f},{u:.2f},{i:.2f},{soc * factor:.4f}"

    source = opened(tmp_path, table(f"t_s,speed_mps,voltage_v,current_a,{name}", DRIVE, line))
    column = rule(source, "charge")
    assert column.name == name and column.factor == pytest.approx(1 / factor)


def test_beside_our_names_nothing_else_is_taken_for_what_they_hold():
    header = [
        "t_s",
        "speed_mps",
        "power_w",
        "time",
        "GPS speed",
        "voltage",
        "heating_w",
        "heater_w",
    ]
    names = {column.name for column in columns_by_name(header, [])}
    assert names == {"t_s", "speed_mps", "power_w", "heating_w"}


@pytest.mark.parametrize("name", ["Ambient temperature", "ambient_kelvin", "Outside temp (K)"])
def test_kelvin_is_no_celsius(tmp_path, name):
    def line(t, v, u, i, *_):
        return f"{t:.0f},{v:.3f},{u:.2f},{i:.2f},279.15"

    source = opened(tmp_path, table(f"t_s,speed (m/s),pack volts,pack amps,{name}", DRIVE, line))
    celsius = [r.celsius for r in source.readings() if isinstance(r, TemperatureReading)]
    assert celsius[0] == pytest.approx(6.0)


def test_the_trolley_buses_of_zurich(tmp_path):
    header = (
        "time_iso,time_unix,electric_powerDemand,gnss_altitude,gnss_latitude,gnss_longitude,"
        "odometry_vehicleSpeed,odometry_wheelSpeed_fl,temperature_ambient,traction_tractionForce"
    )

    def line(t, v, u, i, far, _):
        place = f"{0.826 + (far - 28_582_000) / 6.371e6:.9f},0.149"
        return f"x,{START.timestamp() + t:.0f},{u * i:.0f},408,{place},{v:.3f},0,279,1"

    source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source) == RIGHT
    assert rule(source, "latitude").factor == pytest.approx(57.29578)
    assert rule(source, "ambient").offset == pytest.approx(-273.15)


def test_the_12_volt_load_of_leafspy_is_none_of_heating_and_cooling(tmp_path):
    """It stands all day, so it is learned as the standing load."""
    header = (
        "t_s,Gids,Pack Volts,Pack Amps,Speed2,Aux Pwr(100w),Est Pwr A/C(50w),Est Pwr Htr(250w)"
    )

    def line(t, v, u, i, *_):
        return f"{t:.0f},400,{u:.2f},{i:.2f},{360 * v:.0f},3,2,8"

    source = opened(tmp_path, table(header, DRIVE, line))
    (load,) = {
        (reading.heating, reading.others)
        for reading in source.readings()
        if isinstance(reading, AuxiliaryReading)
    }
    assert load == (2000.0, 100.0) and "Aux Pwr(100w)" in source.ignored


@pytest.mark.parametrize("suffix", [".json", ".jsonl"])
@pytest.mark.parametrize("chosen", [(), ("speed=telemetry.kmh:km/h",)])
def test_json_in_levels_is_named_by_its_path(tmp_path, suffix, chosen):
    rows = [
        {
            "at": {"timestamp": float(t)},
            "telemetry": {"kmh": 3.6 * v, "pack": {"voltage": u, "current": i}, "list": [1]},
        }
        for t, v, u, i in zip(
            *(DRIVE.time, DRIVE.speed, DRIVE.voltage, DRIVE.current), strict=True
        )
    ]
    lines = "\n".join(map(json.dumps, rows)) if suffix == ".jsonl" else json.dumps({"rows": rows})
    source = opened(tmp_path, lines, f"drive{suffix}", columns=chosen)
    assert measured(source) == RIGHT
    assert rule(source, "speed").name == "telemetry.kmh"


@pytest.mark.parametrize("unit, factor", [("mph", 1 / 0.44704), ("km/h", 3.6), ("m/s", 1.0)])
@pytest.mark.parametrize("form", ["beside", "before", "in levels"])
def test_a_unit_in_a_column_of_its_own_is_used(tmp_path, form, unit, factor):
    if form == "in levels":
        rows = [
            {"time": t, "speed": {"unit": unit, "value": factor * v}, "voltage": u}
            | {"current": {"value": 1e3 * i, "uom": "mA"}}
            for t, v, u, i in zip(*SIGNALS, strict=True)
        ]
        source = opened(tmp_path, json.dumps(rows), "drive.json")
    else:
        names = ["speed", "speed_unit"] if form == "beside" else ["Speed unit", "Speed value"]

        def line(t, v, u, i, *_):
            speed = f"{factor * v:.4f}", unit
            cells = ",".join(speed if form == "beside" else speed[::-1])
            return f"{t:.0f},{cells},{u:.3f},{1e3 * i:.1f},mA"

        header = f"time,{','.join(names)},voltage,current,current units"
        source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source) == RIGHT and not any("is assumed" in note for note in source.notes)


def test_a_unit_that_changes_on_the_way_is_refused(tmp_path):
    def line(t, v, u, i, *_):
        kmh, unit = (3.6 * v, "km/h") if t < 300 else (v / 0.44704, "mph")
        return f"{t:.0f},{kmh:.2f},{unit},{u:.2f},{i:.2f}"

    with pytest.raises(InputError, match="'speed unit': the unit changes between km/h and mph"):
        opened(tmp_path, table("time,speed,speed unit,voltage,current", DRIVE, line))


def test_a_current_without_a_value_is_told(tmp_path):
    """Beside a voltage of 12 V it ended with a traceback."""
    header = "time (s),speed (km/h),battery voltage (V),battery current (A)"
    text = table(header, DRIVE, lambda t, v, *_: f"{t:.0f},{3.6 * v:.1f},12.4,")
    assert "current" in " ".join(opened(tmp_path, text).notes)


@pytest.mark.parametrize("apart", [0.0, 0.2])
@pytest.mark.parametrize("first", ["voltage", "power"])
def test_a_power_and_a_voltage_in_rows_of_their_own_are_both_used(tmp_path, apart, first):
    """Half of the powers were lost, as not later than their voltage."""

    def line(t, v, u, i, *_):
        rows = {"voltage": f"{3.6 * v:.2f},{u:.2f},", "power": f",,{u * i:.1f}"}
        other = "power" if first == "voltage" else "voltage"
        return f"{t:.1f},{rows[first]}\n{t + apart:.1f},{rows[other]}"

    header = "time (s),Speed (km/h),Open circuit voltage (V),Battery power (W)"
    source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source) == RIGHT and not source.dropped
