"""Onboard estimation of an electric car's parameters, power and energy."""

__version__ = "0.1.0"
