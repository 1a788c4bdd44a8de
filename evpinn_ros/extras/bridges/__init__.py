"""Cars whose data already flow elsewhere: MQTT (TeslaMate, OVMS, any topics) and COVESA VSS."""
