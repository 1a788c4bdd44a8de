"""The picture of docs/guides/replay.md: a simulated drive, replayed, in a headless Chromium.

Run: python docs/report.py (`make docs` does)
"""

from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

ROOT = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "chrome")
SIZE = "1100,1720"  # CSS pixels: what the drive took and why, and the first curves
DRIVE = ("--kind", "mixed", "--duration", "900", "--seed", "7", "--altitude", "--temperature")


def evpinn(folder: Path, *arguments: str) -> None:
    """One command, run in a folder so that no path of this machine is in the picture."""
    subprocess.run([sys.executable, "-m", "evpinn_ros", *arguments], cwd=folder, check=True)


def main() -> None:
    """Simulate, replay, open, photograph."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        sys.exit("docs/report.py: no Chromium here: apt-get install chromium")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        evpinn(folder, "simulate", "commute", *DRIVE)
        vehicle = ("--vehicle", "tesla_model_3_lr")
        evpinn(folder, "replay", "commute", *vehicle, "--report", "commute.html")
        quiet = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
        picture = f"--screenshot={ROOT / 'docs' / 'report.png'}"
        page = (folder / "commute.html").as_uri()
        command = [browser, *quiet, f"--window-size={SIZE}", picture, page]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)  # it misses a desktop


if __name__ == "__main__":
    main()
