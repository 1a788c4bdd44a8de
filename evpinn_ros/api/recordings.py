"""Replays of recorded drives from Python."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from evpinn_ros.api.result import Result
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import StateClaim
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.logs.formats import files_of
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.terrain import Terrain
from evpinn_ros.logs.trips import joined, split
from evpinn_ros.replays.car import CarReplay, mode_of
from evpinn_ros.replays.run import WARM_UP, ReplayOptions

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


def replay(
    drive: str | os.PathLike[str] | pd.DataFrame | pl.DataFrame,
    vehicle: str | Path | Vehicle = "generic",
    *,
    mode: str | None = None,
    params: str | os.PathLike[str] | None = None,
    state: str | os.PathLike[str] | None = None,
    withhold_battery_after: float | None = None,
    warm_up: float = WARM_UP,
    start: float = 0.0,
    duration: float | None = None,
    can_profile: str | None = None,
    trust_profile: bool = False,
    columns: Sequence[str] = (),
    car: str | None = None,
    elevation: str | os.PathLike[str] | None = None,
) -> Result:
    """Replay a recorded drive; the numbers are exactly those of `evpinn replay`.

    Example:
        >>> import evpinn_ros as ev
        >>> result = ev.replay("bags/urban", vehicle="tesla_model_3_lr", duration=60.0)
        >>> result.power[["measured_w", "smoothed_w"]].plot()  # doctest: +SKIP

    Args:
        drive: path of a bag, CAN log or table; or a DataFrame of pandas or polars with the columns
            of such a table. An index is a column too, if it has a name or does not just number
            the rows.
        vehicle: name or file of a vehicle, or a `Vehicle`.
        mode: `hybrid` or `paper`; if not given, that of `params`, otherwise `hybrid`.
        params: parameter file of the nodes.
        state: file of what was learned: read at the start if it exists, written at the end. With
            the same file, each drive of a car starts from what its earlier drives taught.
        withhold_battery_after: time, s, from which on the battery is hidden, so that power and
            energy are predicted from speed alone.
        warm_up: time at the start that is not scored, s.
        start: time at the start that is left out, s.
        duration: length of the part to replay, s; the whole drive if not given.
        can_profile: profile of a CAN log; that of the vehicle if not given.
        trust_profile: True to use the profile even if the traffic contradicts it.
        columns: corrections for the columns of a table, `speed=NAME` or `speed=NAME:km/h`.
        car: which of several cars to read: its name in a table's column of cars, or the namespace
            of its topics in a bag.
        elevation: folder of SRTM (`N48E011.hgt`) or GeoTIFF tiles, which give heights to a drive
            that has positions.

    Raises:
        InputError: the drive, the vehicle or a file cannot be used; the text says why.
    """
    with _opened(
        drive,
        vehicle,
        ReplayOptions(withhold_battery_after, warm_up, start=start, duration=duration),
        mode=mode,
        params=params,
        state=state,
        can_profile=can_profile,
        trust_profile=trust_profile,
        columns=columns,
        car=car,
        elevation=elevation,
    ) as (car_replay, logs):
        if len(logs) > 1:
            instead = f"ev.replay_trips({str(drive)!r}) replays each"
            raise InputError(f"{drive}: {len(logs)} recordings; {instead}")
        ((whole,), _) = split(logs[0], whole=True)
        return _result(car_replay, whole)


def replay_trips(
    drive: str | os.PathLike[str] | pd.DataFrame | pl.DataFrame,
    vehicle: str | Path | Vehicle = "generic",
    *,
    withhold_battery_after: float | None = None,
    warm_up: float = WARM_UP,
    **options: Any,
) -> list[Result]:
    """Replay each trip of a log or a folder of logs; each starts from what earlier ones taught.

    A trip ends where the car is parked for ten minutes or charged.

    Example:
        >>> import evpinn_ros as ev
        >>> for trip in ev.replay_trips("day.csv", vehicle="bmw_i3"):  # doctest: +SKIP
        ...     print(trip)

    Args:
        drive: as `replay` takes it, or a folder, whose logs follow in the order of their names.
        vehicle: name or file of a vehicle, or a `Vehicle`.
        withhold_battery_after: time, s, of each trip from which on the battery is hidden.
        warm_up: time at the start of each trip that is not scored, s.
        options: `mode`, `params`, `state`, `can_profile`, `trust_profile`, `columns`, `car`,
            `elevation` of `replay`.

    Raises:
        InputError: the drive, the vehicle or a file cannot be used; the text says why.
    """
    scored = ReplayOptions(withhold_battery_after, warm_up)
    with _opened(drive, vehicle, scored, **options) as (car_replay, logs):
        drives = joined(logs)
        trips = (split(log, ahead=len(drives) == 1)[0] for log in drives)
        return [_result(car_replay, trip) for of_log in trips for trip in of_log]


@contextmanager
def _opened(
    drive: str | os.PathLike[str] | pd.DataFrame | pl.DataFrame,
    vehicle: str | Path | Vehicle,
    options: ReplayOptions,
    *,
    mode: str | None = None,
    params: str | os.PathLike[str] | None = None,
    state: str | os.PathLike[str] | None = None,
    elevation: str | os.PathLike[str] | None = None,
    **reading: Any,
) -> Iterator[tuple[CarReplay, list[Source]]]:
    """Yields the car and its logs, opened with `ReadOptions`; then writes what was learned."""
    written = None if state is None else Path(state)
    terrain = None if elevation is None else Terrain(Path(elevation))
    with StateClaim(written):
        car_replay = CarReplay(
            vehicle,
            options,
            mode=None if mode is None else mode_of(mode),
            params=None if params is None else Path(params),
            state=written,
        )
        read_options = ReadOptions(terrain=terrain, **reading)
        with TemporaryDirectory() as folder:
            paths = files_of(_path_of(drive, Path(folder)))
            yield car_replay, [car_replay.open(path, read_options) for path in paths]
        if written is not None:
            car_replay.write_state(written)


def _result(car: CarReplay, source: Source) -> Result:
    replayed = car.replay(source)
    learned, rested = car.chain.estimator.model(), car.at_next_drive().model()
    account = deepcopy(car.chain.account)
    return Result(replayed, car.vehicle, car.options, learned, rested, account)


def _path_of(drive: Any, folder: Path) -> Path:
    path = folder / "drive.csv"
    if hasattr(drive, "write_parquet"):  # of polars, which has no index
        path = path.with_suffix(".parquet")
        objects = [name for name, kind in drive.schema.items() if str(kind) == "Object"]
        drive.drop(objects).write_parquet(path)
    elif hasattr(drive, "to_csv"):  # of pandas
        if drive.index.dtype.kind == "m":
            drive = drive.set_axis(drive.index.total_seconds().rename("time"))
        named = drive.index.name is not None or drive.index.dtype.kind not in "iu"
        drive.to_csv(path, index=named, index_label=drive.index.name or "time")
    else:
        return Path(drive)
    return path
