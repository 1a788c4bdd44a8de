"""Time until a newcomer has a first picture of their own CSV: their commands, timed.

The CSV is another logger's: names, units, sign, separator and decimals are not ours. Simulated, so
that anybody can repeat it.

Run: python docs/first_picture.py [MINUTES]
"""

from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time

from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

HEAD = "Zeit [ms];Fahrzeuggeschwindigkeit [km/h];HV Batteriespannung [V];HV Batteriestrom [A];Gang"
BROWSERS = ("chromium", "chromium-browser", "chrome")
QUIET = ("--headless=new", "--no-sandbox", "--disable-gpu")


def write_csv(path: Path, minutes: float) -> None:
    """A drive as a stranger's logger writes it: discharging is positive, decimals have a comma."""
    drive = simulate(DriveKind.MIXED, load_vehicle("nissan_leaf"), 60 * minutes, 7)
    battery, rows = None, [HEAD]
    for reading in drive.readings:
        if isinstance(reading, BatteryReading):
            battery = reading
        elif isinstance(reading, SpeedReading) and battery is not None:
            ms = (reading.stamp_ns - drive.readings[0].stamp_ns) * 1000 // NANOSECONDS
            row = f"{ms};{3.6 * reading.speed:.1f};{battery.voltage:.1f};{-battery.current:.1f};D"
            rows.append(row.replace(".", ","))
    path.write_text("\n".join(rows) + "\n", encoding="latin-1")


def main() -> None:
    """Write the CSV, type the commands of docs/guides/replay.md, open the report."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    with tempfile.TemporaryDirectory() as folder:
        write_csv(Path(folder, "fahrt.csv"), float(sys.argv[1]) if len(sys.argv) > 1 else 30.0)
        evpinn = (sys.executable, "-m", "evpinn_ros")
        steps = [
            (*evpinn, "info", "fahrt.csv"),
            (*evpinn, "replay", "fahrt.csv", "--vehicle", "nissan_leaf", "--report", "mine.html"),
        ]
        if browser is not None:
            page = Path(folder, "mine.html").as_uri()
            steps.append((browser, *QUIET, "--screenshot=mine.png", page))
        for step in steps:
            begun = time.perf_counter()
            subprocess.run(step, cwd=folder, check=True)
            print(f"--- {time.perf_counter() - begun:.1f} s\n")


if __name__ == "__main__":
    main()
