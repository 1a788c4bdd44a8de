"""Bridges to cars with live data elsewhere: MQTT (TeslaMate, OVMS, any topics), COVESA VSS."""
