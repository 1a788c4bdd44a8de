"""Any file of a drive into readings: tables of every log app, spreadsheets, measurement files.

`open_drive` is the way in. Libraries split, unpack and convert (csv, polars, openpyxl, pyarrow,
asammdf); what is here finds out which column is what, in which unit, on which clock.
"""

from evpinn_ros.drives.open_drive import open_drive

__all__ = ["open_drive"]
