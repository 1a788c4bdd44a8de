"""The estimator from Python, sample by sample."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from evpinn_ros.api.result import breakdown_frame, parameter_frame
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.power_model import PowerModel
from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.state_file import StateClaim
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.car import CarReplay, mode_of
from evpinn_ros.replays.energy_metrics import breakdown_metrics
from evpinn_ros.replays.forecasts import known_model
from evpinn_ros.replays.run import ReplayOptions
from evpinn_ros.replays.scoring import parameter_metrics

if TYPE_CHECKING:
    import pandas as pd

NAN = math.nan


class Estimate(NamedTuple):
    """Prediction for one sample; power and energy are positive when drawn from the battery.

    Attributes:
        t_s: time of the sample, s, as it was given.
        power_w: battery power, W, predicted without the battery readings of this sample.
        sigma_w: its 1-sigma, W.
        energy_j: energy since the start, J: measured where the battery was, otherwise predicted.
        energy_sigma_j: its 1-sigma, J.
    """

    t_s: float
    power_w: float
    sigma_w: float
    energy_j: float
    energy_sigma_j: float


class Estimator:
    """Learns a car sample by sample and predicts its power, as the ROS nodes do, without ROS.

    Example:
        >>> import evpinn_ros as ev
        >>> estimator = ev.Estimator("bmw_i3")
        >>> for second in range(60):
        ...     speed = min(0.5 * second, 15.0)
        ...     now = estimator.add(float(second), speed, voltage_v=380.0, current_a=2.0 * speed)
        >>> round(now.t_s), now.sigma_w > 0.0
        (59, True)

    Attributes:
        vehicle: the car.
    """

    def __init__(
        self,
        vehicle: str | Path | Vehicle = "generic",
        *,
        mode: str = "hybrid",
        state: str | os.PathLike[str] | None = None,
    ) -> None:
        """Start from the vehicle file, or from what was learned before.

        Args:
            vehicle: name or file of a vehicle, or a `Vehicle`.
            mode: `hybrid` or `paper`.
            state: file written by `save`, or by a replay with `state`.

        Raises:
            InputError: the vehicle, mode or file does not exist, or the state belongs to another
                vehicle or mode.
        """
        path = None if state is None else Path(state)
        if path is not None and not path.exists():
            raise InputError(f"{path}: no such file; a replay with this state writes it")
        car = CarReplay(vehicle, ReplayOptions(), mode=mode_of(mode), state=path)
        self.vehicle, self._car, self._chain = car.vehicle, car, car.chain
        self._mode = mode_of(mode)

    def add(
        self,
        t_s: float,
        speed_mps: float = NAN,
        voltage_v: float = NAN,
        current_a: float = NAN,
        *,
        soc_pct: float = NAN,
        elevation_m: float = NAN,
        ambient_c: float = NAN,
        heating_w: float = NAN,
        aircon_w: float = NAN,
    ) -> Estimate | None:
        """Predict one sample, then learn from it.

        The arguments have the names of the columns of a CSV file. Leave out what was not measured.

        Args:
            t_s: time, s, of any clock that does not go back.
            speed_mps: speed of the car, m/s.
            voltage_v: voltage of the battery, V.
            current_a: current of the battery, A, positive when drawn.
            soc_pct: state of charge, percent.
            elevation_m: elevation, m.
            ambient_c: outside temperature, degrees Celsius.
            heating_w: electric power of the heating, W.
            aircon_w: electric power of the air conditioning, W.

        Returns:
            The prediction for this sample; None if it has no speed, or if its time goes back.

        Raises:
            InputError: the time is not finite.
        """
        if not math.isfinite(t_s):
            raise InputError(f"t_s is {t_s}, not a finite number")
        stamp_ns = round(float(t_s) * NANOSECONDS)
        measured = (speed_mps, voltage_v, current_a, soc_pct)
        speed_mps, voltage_v, current_a, soc_pct = map(float, measured)
        elevation_m, ambient_c = float(elevation_m), float(ambient_c)
        heating_w, aircon_w = float(heating_w), float(aircon_w)
        battery = BatteryReading(stamp_ns, voltage_v, -current_a, soc_pct / 100)
        loads = AuxiliaryReading(stamp_ns, *(0.0 if x != x else x for x in (heating_w, aircon_w)))
        given: list[tuple[Reading, tuple[float, ...]]] = [
            (SpeedReading(stamp_ns, speed_mps), (speed_mps,)),
            (battery, (voltage_v, current_a, soc_pct)),
            (AltitudeReading(stamp_ns, elevation_m), (elevation_m,)),
            (TemperatureReading(stamp_ns, ambient_c), (ambient_c,)),
            (loads, (heating_w, aircon_w)),
        ]
        readings = [reading for reading, values in given if not all(map(math.isnan, values))]
        predictions = [
            output
            for output in self._chain.add_readings(readings)
            if isinstance(output, PowerEstimate) and output.kind is PowerKind.PREDICTED
        ]
        if not predictions:
            return None
        energy = self._chain.account.state
        power = predictions[-1]
        return Estimate(t_s, power.power, power.sigma, energy.consumed, energy.consumed_sigma)

    def begin_next_drive(self) -> None:
        """Begin a new drive: time and energy start at zero, and what was learned is kept."""
        self._chain.begin_next_drive()

    @property
    def parameters(self) -> pd.DataFrame:
        """Present parameters, one row each: value, std, prior_share, lower, upper, state."""
        return parameter_frame(parameter_metrics(self._chain.estimator.parameters()))

    @property
    def breakdown(self) -> pd.DataFrame:
        """Parts into which the energy of this drive went, one row each, as in `Result`."""
        estimator = self._chain.estimator
        mass = estimator.parameters().parameters["mass"].state
        return breakdown_frame(breakdown_metrics(estimator.breakdown(), self._mode.value, mass))

    @property
    def model(self) -> PowerModel:
        """The car as known now, for `core.energy.forecast`; `ev.forecast` takes the estimator."""
        estimator = self._chain.estimator
        return known_model(estimator.model(), estimator.parameters(), self.vehicle)

    @property
    def next_model(self) -> PowerModel:
        """The car as it would start its next drive: what `save` writes."""
        estimator = self._car.at_next_drive()
        return known_model(estimator.model(), estimator.parameters(), self.vehicle)

    @property
    def account(self) -> EnergyAccount:
        """Energy counted so far, with what is known of the battery."""
        return self._chain.account

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save what was learned about the car and its battery to a file.

        Give this file as `state` to `Estimator` or `evpinn_ros.replay` to continue from it.

        Raises:
            InputError: another process learns into the file.
            OSError: the file cannot be written.
        """
        with StateClaim(Path(path)):
            self._car.write_state(Path(path))
