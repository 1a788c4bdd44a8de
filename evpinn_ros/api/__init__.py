"""The public Python API: each command as a call that returns DataFrames."""

from evpinn_ros.api.estimator import Estimate, Estimator
from evpinn_ros.api.plan import EdgeEnergies, edge_energies, forecast
from evpinn_ros.api.recordings import replay, replay_trips
from evpinn_ros.api.result import Result
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.files import Vehicle, find_vehicles, load_vehicle

__all__ = [
    "EdgeEnergies",
    "Estimate",
    "Estimator",
    "InputError",
    "Result",
    "Vehicle",
    "edge_energies",
    "find_vehicles",
    "forecast",
    "load_vehicle",
    "replay",
    "replay_trips",
]
