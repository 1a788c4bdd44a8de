"""Recognises CAN logs by name and header, without importing their readers."""

MF4 = ".mf4"
LOG_SUFFIXES = (".log", ".asc", ".blf", ".trc", ".csv", MF4)
GVRET_HEADER = "Time Stamp,ID,Extended"
