"""Drives of one car compared: one chain learns from all of them, and keeps their breakdowns."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
import time
from typing import Any

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.sources import Source
from evpinn_ros.estimation.breakdown import LEAST_DISTANCE, Breakdown, Breakdowns
from evpinn_ros.estimation.estimator import EstimatorSettings, Mode
from evpinn_ros.estimation.state_file import read_state
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.replays.breakdown_text import NOTHING, breakdown_metrics
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.run import Progress, ReplayOptions, replay
from evpinn_ros.signals.time_jump import JumpPolicy, JumpRule
from evpinn_ros.vehicle.files import Vehicle

Bar = Callable[[Source], AbstractContextManager[Progress]]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Drives side by side, the first what the others are compared with.

    Attributes:
        vehicle: whose drives they are.
        paths: where each came from.
        names: short ones, no two alike.
        drives: their series.
        breakdowns: of each by all that was learned, with the covariance between them.
        problems: what could not be read.
    """

    vehicle: Vehicle
    paths: tuple[Path, ...]
    names: tuple[str, ...]
    drives: tuple[Drive, ...]
    breakdowns: Breakdowns
    problems: tuple[str, ...] = ()

    def parts(self) -> list[Breakdown]:
        """The breakdown of each drive."""
        return [found for i in range(len(self.drives)) if (found := self.breakdowns.of(i))]

    def differences(self) -> list[Breakdown]:
        """Every drive but the first, less the first, of 100 km each."""
        return [self.breakdowns.difference(i, 0) for i in range(1, len(self.drives))]

    def metrics(self) -> dict[str, Any]:
        """All of it for scripts; `breakdown` as in the metrics of a replay."""
        mode = Mode.HYBRID.value
        pairs = zip(self.names[1:], self.differences(), strict=True)
        return {
            "vehicle": self.vehicle.key,
            "drives": [
                {"name": name, "path": str(path), "breakdown": breakdown_metrics(found, mode)}
                for name, path, found in zip(self.names, self.paths, self.parts(), strict=True)
            ],
            "differences": [
                {"drive": name, "less": self.names[0], "breakdown": breakdown_metrics(found, mode)}
                for name, found in pairs
            ],
        }


def compare(
    sources: Iterable[Source],
    vehicle: Vehicle,
    *,
    state: Path | None = None,
    duration: float | None = None,
    progress: Bar,
) -> Comparison:
    """Drive one car through all recordings, and compare where the energy of each went.

    Args:
        sources: the drives, the one to compare with first.
        vehicle: the car of all of them.
        state: file of what was learned of the car before, which is left as it is.
        duration: s of each that are compared, None for all.
        progress: a bar for each source.

    Raises:
        InputError: a drive is too short, its battery was not measured, or the state does not fit.
    """
    settings, rule = EstimatorSettings(keep_drives=True), JumpRule(JumpPolicy.HOLD)
    chain = Chain(vehicle, settings, InlineWorker(time.perf_counter), rule)
    if state is not None:
        _restore(chain, state)
    found: Breakdowns | None = None
    paths: list[Path] = []
    drives: list[Drive] = []
    owners: list[int] = []  # drive that each breakdown is of: a long stop begins another
    problems: list[str] = []
    for source in sources:
        if drives:
            chain.begin_next_drive()
        with progress(source) as report:
            done = replay(
                source,
                chain,
                ReplayOptions(duration=duration),
                vehicle=vehicle.key,
                mode=settings.mode.value,
                progress=report,
            )
        found = chain.estimator.breakdowns()
        new = () if found is None else found.drives[len(owners) :]
        owners += [len(drives) for each in new if each.seconds]
        if sum(each.distance for each in new) < LEAST_DISTANCE:
            raise InputError(f"{source.path}: nothing to compare: {NOTHING}")
        paths.append(source.path)
        drives.append(done.drive)
        problems += [done.problem] if done.problem else []
    assert found is not None, "the loop has seen to it"
    return Comparison(
        vehicle=vehicle,
        paths=tuple(paths),
        names=short_names(paths),
        drives=tuple(drives),
        breakdowns=found.joined(owners + owners[-1:] * (len(found.drives) - len(owners))),
        problems=tuple(problems),
    )


def _restore(chain: Chain, state: Path) -> None:
    saved = read_state(state)
    if saved is None:
        raise InputError(f"{state}: no such file")
    try:
        chain.estimator.restore(saved)
    except ValueError as error:
        raise InputError(f"{state}: {error}") from error
    chain.begin_next_drive()


def short_names(paths: list[Path]) -> tuple[str, ...]:
    """A name for each drive, as short as it can be: of the file, with its folder if need be."""
    whole = [path.resolve() for path in paths]
    for length in range(1, 1 + max(len(path.parts) for path in whole)):
        names = ["/".join(path.parts[-length:]) for path in whole]
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(f"{number}: {path.name}" for number, path in enumerate(whole, start=1))
