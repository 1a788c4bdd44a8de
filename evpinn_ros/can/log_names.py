"""Names and headers by which a CAN log is known: what tells files apart need not read them."""

MF4 = ".mf4"
LOG_SUFFIXES = (".log", ".asc", ".blf", ".trc", ".csv", MF4)
GVRET_HEADER = "Time Stamp,ID,Extended"
