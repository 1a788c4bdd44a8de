"""Onboard estimation of an electric car's parameters, power and energy.

`__all__` is what Python may rely on; `docs/guides/python.md` shows it in use. Each name is loaded
when it is asked for, so importing the package costs nothing, and none of them needs ROS.
"""

from importlib import import_module
from typing import Any

__version__ = "0.4.0"

__all__ = [
    "EdgeEnergies",
    "Estimate",
    "Estimator",
    "InputError",
    "Result",
    "Vehicle",
    "__version__",
    "edge_energies",
    "find_vehicles",
    "forecast",
    "load_vehicle",
    "replay",
    "replay_trips",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("evpinn_ros.api"), name)


def __dir__() -> list[str]:
    return __all__
