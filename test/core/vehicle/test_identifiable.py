from hypothesis import given
from hypothesis import strategies as st
import pytest

from evpinn_ros.core.vehicle.identifiable import identifiable
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import RegenForm, battery_power
from test.combined import combined_power
from test.core.vehicle.test_physics import cars

AREA, DENSITY = 2.2, 1.17
moments = st.tuples(st.floats(-3.0, 50.0), st.floats(-6.0, 6.0), st.floats(-0.2, 0.2))


def power(moment, car):
    v, a, grade = moment
    return battery_power(
        v,
        a,
        car,
        area=AREA,
        air_density=DENSITY,
        form=RegenForm.WHEEL_POWER,
        beta=-0.045,
        grade=grade,
    )


def test_combinations_by_hand():
    combined = identifiable(Parameters(0.8, 0.6, 1600.0, 0.01, 0.24, 500.0), 2.0)
    # 1600 / 0.8, 2 * 0.24 / 0.8, C_rr, 0.8 * 0.6, P_aux
    assert combined == pytest.approx((2000.0, 0.6, 0.01, 0.48, 500.0))


@given(moments, cars)
def test_combined_power_is_battery_power(moment, car):
    v, a, grade = moment
    combined = identifiable(car, AREA)
    by_combinations = combined_power(v, a, combined, air_density=DENSITY, grade=grade)
    assert by_combinations == pytest.approx(power(moment, car), rel=1e-9, abs=1e-6)


def test_rotating_parts_scale_the_inertia_alone():
    combined = identifiable(Parameters(0.8, 0.6, 1600.0, 0.01, 0.24, 500.0), 2.0)
    plain = combined_power(10.0, 1.5, combined, air_density=1.2)
    turning = combined_power(10.0, 1.5, combined, air_density=1.2, rotating_mass_factor=1.03)
    assert turning - plain == pytest.approx(0.03 * 2000.0 * 1.5 * 10.0)
    steady = combined_power(10.0, 0.0, combined, air_density=1.2, rotating_mass_factor=1.03)
    assert steady == combined_power(10.0, 0.0, combined, air_density=1.2)
