"""Does `make core` find a core that is broken? Plants one fault after the other in a copy.

`make mutants` runs it, as the nightly workflow does. Each fault is a text that stands once in a
file of the core, and what is put in its place. The tests that mirror the file run first, then
all of `make core`: a fault is found when one of them fails. Prints a line per fault, and fails
when one was not found or its text is no longer there.
"""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
COPIED = (
    "evpinn_ros",
    "test",
    "benchmarks",
    "config",
    "pyproject.toml",
    "setup.py",
    "package.xml",
)
ROOMS = ("signals", "estimation", "energy")


class Fault(NamedTuple):
    """One fault: what is wrong, in which module, and the text that becomes another."""

    name: str
    module: str
    right: str
    wrong: str


FAULTS = (
    Fault("sign of battery power", "core/signals/readings", "-volts * amperes", "volts * amperes"),
    Fault("trapezoid twice as large", "core/signals/power", "@ step) / 2", "@ step)"),
    Fault("kinetic energy doubled", "core/signals/interval",
          "np.diff(speed**2) / 2", "np.diff(speed**2)"),
    Fault("uphill is downhill", "core/signals/interval",
          "np.diff(np.array(h", "-np.diff(np.array(h"),
    Fault("Simpson's middle twice", "core/signals/kinematics",
          "4 * drag(middle)", "2 * drag(middle)"),
    Fault("speed and its slope swapped", "core/signals/kinematics",
          "float(coefficients[0]), float(coefficients[1])",
          "float(coefficients[1]), float(coefficients[0])"),
    Fault("drag doubled", "core/estimation/terms",
          "drag, rolling = 0.5 *", "drag, rolling = 1.0 *"),
    Fault("braking gives all back", "core/estimation/terms",
          "(1.0 - driving) * self.back", "(1.0 - driving)"),
    Fault("correction away from the data", "core/estimation/gaussian",
          "state.mean + gain", "state.mean - gain"),
    Fault("certainty falls with data", "core/estimation/gaussian",
          "state.covariance - change", "state.covariance + change"),
    Fault("time adds no uncertainty", "core/estimation/gaussian",
          "@ transition.T + noise", "@ transition.T"),
    Fault("noise left out of an innovation", "core/estimation/gaussian",
          'along) + noise, along', 'along), along'),
    Fault("the wandering load never forgets", "core/estimation/journey",
          "xp.exp(-seconds / LOAD_TIME)", "xp.exp(-0.0 * seconds)"),
    Fault("sums of load and climb swapped", "core/estimation/posterior",
          "(energy, State.WANDERED), (climb, State.CLIMBED)",
          "(energy, State.CLIMBED), (climb, State.WANDERED)"),
    Fault("offsets of a drive are kept whole", "core/estimation/posterior",
          "kept[OFFSETS] = keep", "kept[OFFSETS] = 1.0"),
    Fault("evidence is never forgotten", "core/estimation/posterior",
          "(1.0 - 1.0 / EVIDENCE_KEPT)", "1.0"),
    Fault("payload changes before any stop taught chance", "core/estimation/payload",
          "self.chance.count >= LEAST_STOPS", "self.chance.count >= 0.0"),
    Fault("a change of payload stays as it was found", "core/estimation/payload",
          "watched=stop, change=stop.payload_change(change))", "watched=stop)"),
    Fault("a change of payload is never withdrawn", "core/estimation/payload",
          "change / stop.change < 0.5", "False"),
    Fault("a pause is learned after it", "core/estimation/estimator",
          "dropout or (self.enabled and sound)", "True"),
    Fault("a restored estimator counts anew", "core/estimation/estimator",
          "learner.gated = self._learner.gated", "pass"),
    Fault("a difference is as seen as its better drive", "core/estimation/breakdown",
          "DIFFERENCE_METRES * max(", "DIFFERENCE_METRES * min("),
    Fault("the network in the terms of eq. 21", "core/estimation/network",
          "explained @ outer)", "0.0 * explained @ outer)"),
    Fault("eta and mass swapped", "core/estimation/published",
          "direction[[MASS, ETA]] = 1.0, -1.0", "direction[[MASS, ETA]] = -1.0, 1.0"),
    Fault("heights averaged with twice the way", "core/signals/height",
          "step * (height + self._height[-1]) / 2", "step * (height + self._height[-1])"),
    Fault("a leap back counts as one ahead", "core/signals/time_jump",
          "(leap_ns > 0) == self.ahead", "(leap_ns > 0) != self.ahead"),
    Fault("errors of rehearsals taken off", "core/estimation/bands",
          "keep * self.squares + square", "keep * self.squares - square"),
    Fault("rehearsals shorter than they are", "core/estimation/rehearsal",
          "rehearsal.journey.seconds < length", "rehearsal.journey.seconds < length / 2"),
    Fault("hills are never forgotten", "core/estimation/bands",
          "math.exp(-self.way / HILLS_MEMORY_METRES)", "1.0"),
    Fault("uneven speed twice as dear", "core/estimation/unevenness",
          "table / (self.metres + PRIOR_METRES)", "2.0 * table / (self.metres + PRIOR_METRES)"),
    Fault("bands grow when all is inside", "core/estimation/calibration",
          "float(missed) - (1.0", "-float(missed) + (1.0"),
    Fault("the trim never forgets", "core/estimation/trim",
          "keep = math.exp(-duration / TRIM_SECONDS)", "keep = 1.0"),
    Fault("energy of a step doubled", "core/energy/quadrature",
          "self.power_next) / 2 * self.dt", "self.power_next) * self.dt"),
    Fault("drawn and regenerated swapped", "core/energy/quadrature",
          "max(self.energy, 0.0), max(-self.energy, 0.0)",
          "max(-self.energy, 0.0), max(self.energy, 0.0)"),
    Fault("a dropout's regenerated energy is drawn", "core/energy/dropout",
          "drawn - regenerated, regenerated", "drawn + regenerated, regenerated"),
    Fault("the state of charge taken for as sure as it says", "core/energy/dropout",
          "gain = (dropout.sigma / both) ** 2", "gain = (by_charge.sigma / both) ** 2"),
    Fault("the last kilometre is never forgotten", "core/energy/trip",
          "self.buckets = self.buckets[1:]", "break"),
    Fault("shares of speed and force swapped", "core/energy/network_table",
          "yield 0, 1, stronger - both", "yield 0, 1, faster - both"),
    Fault("a far-off trip counts in full", "core/energy/charge",
          "max(found.sigma, abs(difference) / OUTLIER) ** 2", "found.sigma**2"),
    Fault("usual legs count nothing", "core/energy/account",
          "self.usual, spread)", "math.nan, spread)"),
    Fault("differences of routes share nothing", "core/energy/edges",
          "self._sum(times[0] - times[1])", "self._sum(times[0] + times[1])"),
    Fault("half of a plan's power", "core/energy/forecast",
          "np.diff(energy) / duration", "np.diff(energy) / duration / 2"),
    Fault("charge rises as energy is drawn", "core/energy/charge",
          "last.charge - taken", "last.charge + taken"),
)  # fmt: skip


def passes(copy: Path, *paths: str) -> bool:
    """Whether the tests of these paths pass in a copy of the tree."""
    options = ("-q", "-x", "--quick", "--hypothesis-profile=quick", "-p", "no:cacheprovider")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *paths],
        cwd=copy, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(copy)},
    )  # fmt: skip
    if done.returncode not in (0, 1):
        raise SystemExit(done.stdout + done.stderr)
    return done.returncode == 0


def found(copy: Path, fault: Fault) -> bool:
    """Whether a test fails while the fault stands in the copy."""
    path = copy / "evpinn_ros" / f"{fault.module}.py"
    sound = path.read_text("utf-8")
    if sound.count(fault.right) != 1:
        raise SystemExit(
            f"{fault.module}: '{fault.right}' stands {sound.count(fault.right)} times"
        )
    path.write_text(sound.replace(fault.right, fault.wrong), "utf-8")
    room, name = fault.module.split("/")
    mirror = copy / "test" / room / f"test_{name}.py"
    try:
        near = mirror.exists() and not passes(copy, str(mirror))
        return near or not passes(copy, *(f"test/{each}" for each in ROOMS))
    finally:
        path.write_text(sound, "utf-8")


def main(wanted: list[str]) -> int:
    """Plant the faults whose module or name holds one of these words, or all of them."""
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        for name in COPIED:
            put = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy.mkdir(exist_ok=True)
            put(ROOT / name, copy / name)
        if not passes(copy, *(f"test/{room}" for room in ROOMS)):
            raise SystemExit("the tests of the core fail without any fault")
        for fault in FAULTS:
            if wanted and not any(word in f"{fault.module} {fault.name}" for word in wanted):
                continue
            begin = time.monotonic()
            caught = found(copy, fault)
            missed += not caught
            verdict = "found" if caught else "MISSED"
            print(
                f"{verdict:7}{time.monotonic() - begin:5.0f} s  {fault.module}: {fault.name}",
                flush=True,
            )
    print(f"{missed} faults missed" if missed else "every fault was found")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
