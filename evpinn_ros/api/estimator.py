"""The estimator from Python, sample by sample."""

from __future__ import annotations

from collections.abc import Iterator
import math
import os
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from evpinn_ros.api.frames import breakdown_frame, parameter_frame
from evpinn_ros.common.arguments import finite, number, path_of
from evpinn_ros.common.errors import InputError
from evpinn_ros.energy.account import EnergyAccount
from evpinn_ros.energy.power_model import PowerModel
from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.replays.car import CarReplay, mode_of
from evpinn_ros.replays.energy_metrics import breakdown_metrics
from evpinn_ros.replays.forecasts import known_model
from evpinn_ros.replays.run import ReplayOptions
from evpinn_ros.replays.scoring import parameter_metrics
from evpinn_ros.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.vehicle.files import Vehicle

NAN = math.nan


class Estimate(NamedTuple):
    """Estimate of one moment; positive when drawn from the battery.

    Attributes:
        t_s: the moment, s, as it was given.
        power_w: battery power, W, predicted without any battery reading of this moment.
        sigma_w: its 1-sigma, W.
        energy_j: since the start, J: measured where possible, predicted elsewhere.
        energy_sigma_j: its 1-sigma, J.
    """

    t_s: float
    power_w: float
    sigma_w: float
    energy_j: float
    energy_sigma_j: float


class Estimator:
    """Learns a car from its samples and predicts its power: the core of the nodes, without ROS.

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
        """Begin at the vehicle's priors, or with what was learned before.

        Args:
            vehicle: name, file, or what `load_vehicle` gave.
            mode: `hybrid` or `paper`.
            state: file that `save` or a replay wrote.

        Raises:
            InputError: no such vehicle, mode or file, or the state is not of them.
        """
        path = None if state is None else path_of("state", state)
        if path is not None and not path.exists():
            raise InputError(f"{path}: no such file")
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

        The arguments are the columns of a drive's CSV; what was not measured is left out.

        Args:
            t_s: time, s, of any clock that goes on.
            speed_mps: m/s.
            voltage_v: of the battery, V.
            current_a: of the battery, A, positive when drawn.
            soc_pct: state of charge, percent.
            elevation_m: m.
            ambient_c: degrees Celsius.
            heating_w: electric power of the heating, W.
            aircon_w: of the air conditioning, W.

        Returns:
            The prediction of this moment; None without a speed, and where the time went back.

        Raises:
            InputError: the time is not finite, or a value is no number.
        """
        stamp_ns = round(finite("t_s", t_s) * NANOSECONDS)
        speed_mps = number("speed_mps", speed_mps)
        voltage_v, current_a = number("voltage_v", voltage_v), number("current_a", current_a)
        soc_pct, elevation_m = number("soc_pct", soc_pct), number("elevation_m", elevation_m)
        ambient_c = number("ambient_c", ambient_c)
        heating_w, aircon_w = number("heating_w", heating_w), number("aircon_w", aircon_w)
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
        found = [each for reading in readings for each in self._predictions(reading)]
        if not found:
            return None
        energy = self._chain.account.state
        power = found[-1]
        return Estimate(t_s, power.power, power.sigma, energy.consumed, energy.consumed_sigma)

    def _predictions(self, reading: Reading) -> Iterator[PowerEstimate]:
        for output in self._chain.add_reading(reading):
            if isinstance(output, PowerEstimate) and output.kind is PowerKind.PREDICTED:
                yield output

    def begin_next_drive(self) -> None:
        """Keep what was learned of the car; time and energy start anew."""
        self._chain.begin_next_drive()

    @property
    def parameters(self) -> pd.DataFrame:
        """Parameters now, a row each: value, std, prior_share, lower, upper, state."""
        return parameter_frame(parameter_metrics(self._chain.estimator.parameters()))

    @property
    def breakdown(self) -> pd.DataFrame:
        """Energy of this drive by where it went, a row a part, as in `Result`."""
        found = breakdown_metrics(self._chain.estimator.breakdown(), self._mode.value)
        return breakdown_frame(found)

    @property
    def model(self) -> PowerModel:
        """The car as known now, for `evpinn_ros.forecast`."""
        estimator = self._chain.estimator
        return known_model(estimator.model(), estimator.parameters(), self.vehicle)

    @property
    def account(self) -> EnergyAccount:
        """Energy counted so far, with what is known of the battery."""
        return self._chain.account

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write what was learned: a file for `state` here and in `evpinn_ros.replay`.

        It holds what was learned of the car, and of its battery.
        """
        self._car.write_state(path_of("path", path))
