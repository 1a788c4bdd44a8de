"""A log of a day is split into its trips."""

from pathlib import Path

import numpy as np
import pytest

import evpinn_ros as ev
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import SpeedReading
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_drive
from evpinn_ros.logs.trips import joined, split, trips_of


class Recorded(Source):
    """A log of given readings."""

    seconds = problem = None

    def __init__(self, readings) -> None:
        super().__init__(Path("log"))
        self._readings = readings

    def read(self):
        yield from Block.of(self._readings()).parts(300)


HEADER = "t_s,speed_mps,voltage_v,current_a\n"


def rows(begin: float, seconds: int, speed: float, current: float) -> str:
    times = begin + np.arange(seconds)
    return "".join(f"{time},{speed},350,{current}\n" for time in times)


def test_trips_end_where_the_car_charges_and_where_the_log_pauses(tmp_path: Path) -> None:
    """Two drives with an hour of charging between them, and a third after a night without rows."""
    path = tmp_path / "day.csv"
    text = rows(0, 300, 10.0, 20.0) + rows(300, 3600, 0.0, -10.0) + rows(3900, 300, 10.0, 20.0)
    path.write_text(HEADER + text + rows(40_000, 300, 10.0, 20.0), encoding="utf-8")
    trips, charged = split(open_drive(path))
    assert [trip.path.name for trip in trips] == ["day:1", "day:2", "day:3"]
    assert charged == pytest.approx(3600 * 3500.0, rel=0.01)
    for trip in trips:
        speeds = [r for r in trip.readings() if isinstance(r, SpeedReading)]
        assert sum(reading.speed > 0 for reading in speeds) == 300
        assert len(speeds) < 370  # half a minute of standing at either end


def test_a_log_of_one_trip_stays_whole(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    path.write_text(HEADER + rows(0, 300, 10.0, 20.0) + rows(300, 3600, 0.0, -10.0))
    log = open_drive(path)
    assert split(log) == ([log], 0.0)


def test_a_lone_row_after_a_pause_is_no_drive(tmp_path: Path) -> None:
    """A replay doubts its stamp, so a trip that went on to it would end before its stop does."""
    path = tmp_path / "torn.csv"
    text = rows(0, 300, 10.0, 20.0) + rows(4000, 300, 10.0, 20.0) + rows(6000, 1, 10.0, 20.0)
    path.write_text(HEADER + text)
    trips, _ = split(open_drive(path))
    assert [trip.stops_s for trip in trips] == [0.0, 0.0]


@pytest.mark.parametrize("ahead", [True, False])
def test_a_log_is_read_once_for_its_trips_and_its_replay(tmp_path: Path, ahead: bool) -> None:
    path = tmp_path / "one.csv"
    path.write_text(HEADER + rows(0, 300, 10.0, 20.0) + "torn\n" + rows(300, 300, 9.0, 20.0))
    whole, log = open_drive(path), open_drive(path)
    readings = [*map(repr, whole.readings())]  # of NaN, which is not itself
    split(log, ahead=ahead)
    path.write_text(HEADER + rows(0, 100, 10.0, 20.0))
    assert [*map(repr, log.readings())] == (readings if ahead else readings[:200])
    if ahead:
        assert log.dropped == whole.dropped and log.notes == whole.notes
    assert [*map(repr, log.readings())] == readings[:200]  # of the file, as it is now


def test_red_lights_and_manoeuvres_are_no_trips(tmp_path: Path) -> None:
    path = tmp_path / "town.csv"
    text = rows(0, 300, 10.0, 20.0) + rows(300, 200, 0.0, 2.0) + rows(500, 300, 10.0, 20.0)
    text += rows(800, 900, 0.0, 2.0) + rows(1700, 20, 2.0, 5.0)
    path.write_text(HEADER + text)
    assert len(trips_of(open_drive(path).blocks()).trips) == 1


def torn(folder: Path, *begins: int, header: str = "time") -> list[Path]:
    """Files of 100 s each, which begin at these s of a day."""
    paths = []
    for number, begin in enumerate(begins):
        path = folder / f"part{number}.csv"
        clock = 1_700_000_000 if header == "time" else 0
        path.write_text(HEADER.replace("t_s", header) + rows(clock + begin, 100, 10.0, 20.0))
        paths.append(path)
    return paths


def test_a_drive_torn_into_files_is_one_again(tmp_path: Path) -> None:
    paths = torn(tmp_path, 0, 103, 300, 2000)
    logs = joined([open_drive(path) for path in paths])
    assert [log.path for log in logs] == [paths[0], paths[3]], "the last begins after half an hour"
    assert logs[0].seconds == pytest.approx(3 * 99.0)
    alone = [reading for path in paths[:3] for reading in open_drive(path).readings()]
    assert repr(list(logs[0].readings())) == repr(alone)
    trips, _ = split(logs[0])
    assert trips == [logs[0]]


def test_files_of_unknown_days_are_not_joined(tmp_path: Path) -> None:
    paths = torn(tmp_path, 0, 103, header="t_s")
    assert [log.path for log in joined([open_drive(path) for path in paths])] == paths


def test_a_file_that_begins_before_the_last_one_ended_is_another_drive(tmp_path: Path) -> None:
    paths = torn(tmp_path, 0, 50)
    assert len(joined([open_drive(path) for path in paths])) == 2


def test_a_log_of_charging_alone_is_no_drive(tmp_path: Path) -> None:
    path = tmp_path / "home.csv"
    path.write_text(HEADER + rows(0, 60, 0.0, 1.0) + rows(60, 3600, 0.0, -10.0))
    why = r"home\.csv: no drive: .* charged with 3\.49 kWh"
    for whole in (False, True):
        with pytest.raises(InputError, match=why):
            split(open_drive(path), whole=whole)
    with pytest.raises(InputError, match=why):
        ev.replay(path, vehicle="bmw_i3")


def day(folder: Path, *drives: float, pause: float = 900.0) -> Path:
    """A log of drives of these s at 10 m/s, with stops between them."""
    text, begin = HEADER, 0.0
    for seconds in drives:
        text += rows(begin, int(seconds), 10.0, 20.0)
        text += rows(begin + seconds, int(pause), 0.0, 0.0)
        begin += seconds + pause
    path = folder / "day.csv"
    path.write_text(text, encoding="utf-8")
    return path


SHORT_DRIVES = {
    "between two long ones": ([200, *[40] * 12, 200], [2000, 4800, 2000], [0, 11, 0]),
    "after a long one": ([200, *[45] * 4], [2000, 1800], [0, 3]),
    "before a long one": ([30, 30, 200], [600, 2000], [1, 0]),
    "one of them, which belongs to the trip before it": ([200, 30, 200], [2300, 2000], [1, 0]),
    "one of them, at the start": ([30, 200, 200], [2300, 2000], [1, 0]),
}


@pytest.mark.parametrize("where", SHORT_DRIVES)
def test_short_drives_count(tmp_path: Path, where: str) -> None:
    drives, distances, stops = SHORT_DRIVES[where]
    trips, _ = split(open_drive(day(tmp_path, *drives)))
    speeds = [[r.speed for r in trip.readings() if isinstance(r, SpeedReading)] for trip in trips]
    assert [sum(of_trip) for of_trip in speeds] == distances
    pauses = [trip.stops_s / (900.0 - 60.0) for trip in trips]
    assert pauses == pytest.approx(stops, abs=0.02)


def test_short_drives_are_told(tmp_path: Path) -> None:
    trips, _ = split(open_drive(day(tmp_path, 200, *[40] * 12, 200)))
    notes = [" ".join(trip.notes) for trip in trips]
    assert [note.startswith("12 drives of less than 500 m") for note in notes] == [
        *(False, True, False)
    ]


@pytest.mark.parametrize("back", [700.0, 4000.0, 86_400.0])
@pytest.mark.parametrize("long", [False, True])
def test_a_clock_that_goes_back_ends_no_trip(tmp_path: Path, back: float, long: bool) -> None:
    """Readings in recorded order: a bag that was stamped anew, a counter that wraps."""

    def readings():
        for second in range(3000 if long else 1000):
            stops = long and 1000 <= second < 2000
            stamp = second - (back if second > 500 else 0.0)
            yield SpeedReading(round(1e9 * (1e6 + stamp)), 0.0 if stops else 10.0)

    log = Recorded(readings)
    trips, _ = split(log)
    if not long:
        assert trips == [log]
    speeds = [[r.speed for r in trip.readings()] for trip in trips]
    assert [sum(of_trip) for of_trip in speeds] == ([10_000.0] * 2 if long else [10_000.0])


def test_a_reading_of_the_future_ends_no_trip() -> None:
    def readings():
        for second in range(1000):
            ahead = 5000 if second == 400 else 0
            yield SpeedReading((second + ahead) * 1_000_000_000, 10.0)

    assert not len(trips_of([Block.of(readings())]).axis.begins)
