"""Energy: metered, integrated by the Runge-Kutta network, and forecast for plans."""
