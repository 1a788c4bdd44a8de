"""Replays the drives of one car in order, for the command line and for Python."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.meter import EnergyMeter
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.breakdown import EndedDrive
from evpinn_ros.core.estimation.estimator import Mode, OnlineEstimator, PaperOptimizer
from evpinn_ros.core.estimation.state_file import Half, read_for_a_person, read_half, write_halves
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.time_jump import JumpPolicy
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.energy_metrics import breakdown_metrics
from evpinn_ros.replays.run import Progress, Replayed, ReplayOptions, replay
from evpinn_ros.replays.totals import totals, with_left_out
from evpinn_ros.replays.trends import trend_metrics
from evpinn_ros.topics.node_parameters import TABLES, Value
from evpinn_ros.topics.parameter_file import read_parameter_file
from evpinn_ros.topics.settings import estimator_settings, imu_mounting, jump_rule


class CarReplay:
    """Replays drives of one car through one chain, in order; learned values are carried over."""

    def __init__(
        self,
        vehicle: str | Path | Vehicle,
        options: ReplayOptions,
        *,
        mode: Mode | None = None,
        optimizer: PaperOptimizer | None = None,
        params: Path | None = None,
        state: Path | None = None,
        keep_drives: bool = False,
    ) -> None:
        """Start from the priors, or from `state` if that file exists.

        With `keep_drives` the breakdown of each drive is kept, and no jump of time resets.

        Raises:
            InputError: the vehicle, a parameter or a file is wrong.
        """
        # One thread, so that results repeat bit by bit, and other cores stay free.
        limit_blas_threads()
        self.vehicle = vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)
        self.options = options  # of every replay
        self.results: list[Replayed] = []  # of the drives so far
        self._before: list[EndedDrive] = []  # parts of all drives but the last
        values = _parameters(params, mode, optimizer)
        self._mounting = imu_mounting(values)
        if keep_drives:
            values["time_jump_policy"] = JumpPolicy.HOLD.value
        settings = replace(estimator_settings(values), keep_drives=keep_drives)
        self._mode = settings.mode
        self.chain = Chain(
            self.vehicle, settings, InlineWorker(time.perf_counter), jump_rule(values)
        )
        self.missing = _restore(self.chain, state)  # a line if half of the state was missing

    def open(self, path: Path, options: ReadOptions = READ_DEFAULTS) -> Source:
        """Open a drive as `open_source` does, with the parameter `imu_rotation_rpy`."""
        return open_source(path, self.vehicle, replace(options, mounting=self._mounting))

    def replay(
        self,
        source: Source,
        *,
        writer: BagWriter | None = None,
        progress: Progress | None = None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> Replayed:
        """Replay the next drive, as `run.replay` does."""
        if self.results:
            self._before += self.chain.estimator.drive()
            self.chain.begin_next_drive()
        replayed = replay(
            source,
            self.chain,
            self.options,
            vehicle=self.vehicle.key,
            mode=self._mode.value,
            writer=writer,
            progress=progress,
            stopped=stopped,
        )
        self.results.append(replayed)
        return replayed

    def breakdown(self) -> dict[str, Any]:
        """The breakdown of all drives together, as in the metrics of a drive."""
        estimator = self.chain.estimator
        mass = estimator.parameters().parameters["mass"].trust
        of_all = estimator.breakdown(self._before)
        metrics = breakdown_metrics(of_all, self._mode.value, mass.value)
        return with_left_out(metrics, self.totals())

    def record(self) -> str | None:
        """Sentence on how well all drives so far were forecast at their start; else None."""
        model = self.at_next_drive().model()
        return None if model is None else model.record.sentence

    def totals(self) -> dict[str, Any]:
        """Totals of all drives together, as in the metrics of a drive."""
        return totals([replayed.drive for replayed in self.results])

    def metrics(self) -> list[dict[str, Any]]:
        """Values of `--metrics` of each drive; the last also has those of all drives together."""
        together = {
            "totals": self.totals(),
            "breakdown": self.breakdown(),
            "trends": trend_metrics([replayed.drive for replayed in self.results]),
        }
        drives = [{**replayed.metrics, "together": None} for replayed in self.results]
        drives[-1]["together"] = together
        return drives

    def at_next_drive(self) -> OnlineEstimator:
        """A copy of the estimator as it would start the next drive."""
        estimator = deepcopy(self.chain.estimator)
        estimator.begin_next_drive()
        return estimator

    def write_state(self, path: Path) -> None:
        """Write learned state and account as they start the next drive; OSError if that fails."""
        account = EnergyAccount(
            EnergyMeter(load_rknn()), self.vehicle.key, self.vehicle.battery_capacity
        )
        account.take(self.chain.account.saved())
        account.begin_next_trip()
        learned = self.at_next_drive().export()
        write_halves(path, {Half.LEARNED: learned, Half.ENERGY: account.export()})


def mode_of(name: str) -> Mode:
    """The mode of this name, or InputError."""
    try:
        return Mode(name)
    except ValueError:
        raise InputError(f"no mode '{name}'; known are {', '.join(Mode)}") from None


def _restore(chain: Chain, state: Path | None) -> str | None:
    """Continue from a state file if it exists; returns a line if half of it is missing."""
    if state is None:
        return None
    with read_for_a_person(state):
        learned, missing = read_half(state, Half.LEARNED)
        counted, uncounted = read_half(state, Half.ENERGY)
        if learned is not None:
            chain.estimator.restore(learned)
        if counted is not None:
            chain.account.restore(counted)
    if learned is not None or counted is not None:
        chain.begin_next_drive()  # the saved drive was on another road
    if counted is not None and learned is None:
        missing = missing or f"{state}: has only an energy account, which is continued"
    return missing or uncounted


def _parameters(
    params: Path | None, mode: Mode | None, optimizer: PaperOptimizer | None
) -> dict[str, Value]:
    """Parameters of the node `estimator`: defaults, overridden by the file, then by arguments."""
    values = {parameter.name: parameter.default for parameter in TABLES["estimator"]}
    if params is not None:
        values.update(read_parameter_file(params, "estimator"))
    if mode is not None:
        values["mode"] = mode.value
    if optimizer is not None:
        if values["mode"] != Mode.PAPER.value:
            raise InputError("--optimizer needs --mode paper")
        values["paper_optimizer"] = optimizer.value
    return values
