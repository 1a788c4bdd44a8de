"""Energy: metered, integrated by the Runge-Kutta network, and forecast for plans."""

from evpinn_ros.core.energy.forecast import Energies, Profiles, forecast

__all__ = ["Energies", "Profiles", "forecast"]
