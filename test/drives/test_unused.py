"""Each column that is not used has a reason that its owner understands."""

from evpinn_ros.drives.column import by_reason
from test.drives.test_columns import drive_of, rows


def test_columns_that_are_not_used_are_told_apart_by_the_reason(tmp_path):
    lines = (
        f"{t:.1f},{3.6 * v:.3f},{3.6 * v:.2f},{u},{i:.3f},,{u * i:.0f},3" for t, v, u, i in rows()
    )
    header = "time,Vehicle speed (km/h),GPS Speed (km/h),Pack Volts,Pack Amps,Heater Power [W],"
    drive = drive_of(tmp_path, f"{header}Motor Pwr(w),gear", lines)
    assert by_reason(drive.ignored) == {
        "speed is read from 'Vehicle speed (km/h)'": ["GPS Speed (km/h)"],
        "empty": ["Heater Power [W]"],
        "not of the whole traction battery": ["Motor Pwr(w)"],
        "not needed": ["gear"],
    }


def test_a_unit_that_is_not_known_costs_no_drive_that_can_do_without(tmp_path):
    lines = (f"{t:.1f},{v:.3f},{u},{i:.3f},80,15" for t, v, u, i in rows())
    header = "t_s,Speed [m/s],Pack Volts,Pack Amps,SOC [bars],Ambient [gas mark]"
    drive = drive_of(tmp_path, header, lines)
    assert drive.ignored == {
        "SOC [bars]": "the unit [bars] of charge is not known",
        "Ambient [gas mark]": "the unit [gas mark] of ambient is not known",
    }


def test_an_empty_column_loses_to_a_full_one_of_the_vehicle_energy_dataset(tmp_path):
    header = (
        "DayNum,Timestamp(s),Vehicle Speed[km/h],OAT[DegC],Air Conditioning Power[kW],"
        "Air Conditioning Power[Watts],HV Battery Current[A],HV Battery Voltage[V]"
    )
    lines = (
        f"197.5,{t:.1f},{3.6 * v:.3f},14.0,NaN,{400 + t:.0f},{-i:.3f},{u}" for t, v, u, i in rows()
    )
    drive = drive_of(tmp_path, header, lines)
    used = {rule.quantity: rule.name for rule in drive.rules}
    assert used["aircon"] == "Air Conditioning Power[Watts]" and used["ambient"] == "OAT[DegC]"
    assert drive.ignored["Air Conditioning Power[kW]"] == "empty"
