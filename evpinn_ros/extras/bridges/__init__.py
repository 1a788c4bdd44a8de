"""Bridges to live data of cars over MQTT (TeslaMate, OVMS, any topics) and COVESA VSS."""
