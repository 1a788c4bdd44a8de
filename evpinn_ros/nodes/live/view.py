"""Live view: receives the topics of running nodes, and shows them ten times a second."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from io import TextIOWrapper
import multiprocessing
import os
from pathlib import Path
import signal
import sys
import tempfile
import time
from typing import TextIO

import rclpy
from rclpy.exceptions import NameValidationException, NotInitializedException
from rclpy.node import Node
from rich.console import Console
from rich.live import Live

from evpinn_ros.common.errors import InputError, as_input_error, printable
from evpinn_ros.common.json_text import json_text
from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.common.writer import new_table
from evpinn_ros.nodes.factory import installed, message_class, qos_profile
from evpinn_ros.nodes.live.data import NOTHING, WATCHED, LiveData
from evpinn_ros.nodes.live.screen import as_json, plain_line, problem_lines, screen
from evpinn_ros.topics import NAMESPACE, QUEUE_DEPTH, Qos

PERIOD = 0.1  # s between updates of the screen
PLAIN_PERIOD = 1.0  # s between lines
YIELDS = 5  # niceness: the nodes have priority
END_TIMEOUT = 5.0  # s for the view to restore the terminal

Show = Callable[[LiveData, float], None]


class LiveListener(Node):
    """Receives the topics of the view, and publishes nothing."""

    def __init__(self, namespace: str, units: Units) -> None:
        super().__init__(
            f"live_view_{os.getpid()}",
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.data = LiveData(self.get_namespace(), units)  # received messages
        profile = qos_profile(Qos(reliable=False, transient_local=False, depth=QUEUE_DEPTH))
        self._inputs = {
            topic: self.create_subscription(
                message_class(topic.type_name), topic.name, lambda _: None, profile
            )  # never called: there is no executor
            for topic in installed(WATCHED)
        }

    def take_all(self) -> None:
        """Take all waiting messages; an executor would wake for each of them."""
        for topic, subscription in self._inputs.items():
            for _ in range(QUEUE_DEPTH):
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, False)
                if taken is None:
                    break
                self.data.take(topic, taken[0], time.monotonic())


def watch(
    namespace: str = NAMESPACE,
    units: Units = METRIC,
    *,
    plain: bool = False,
    json_file: Path | None = None,
) -> None:
    """Show running nodes until a signal, or until the parent process has ended.

    `plain` prints lines; `json_file` (`-`: stdout) gets a JSON object a second.

    Raises:
        InputError: the namespace is wrong, ROS does not start, or `json_file` exists.
    """
    os.nice(YIELDS)
    # As in `running.run`: rclpy's own handler shuts down at SIGINT.
    signal.signal(signal.SIGINT, lambda *_: None)
    started = False
    try:
        rclpy.init(args=[])
        started = True
        listener = LiveListener(namespace, units)
    except (NameValidationException, NotInitializedException, RuntimeError) as error:
        if started and not rclpy.ok():
            return  # a signal during the start
        rclpy.try_shutdown()
        raise InputError(" ".join(str(error).split())) from error
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # not every terminal can show Braille
    console = Console(highlight=False)
    # With FORCE_COLOR set, rich itself would treat a pipe as a terminal.
    drawn = console.is_terminal and sys.stdout.isatty() and not console.is_dumb_terminal
    to_stdout = str(json_file) == "-"
    try:
        with ExitStack() as stack:
            shows: list[tuple[float, Show]] = []
            if json_file is not None:
                with as_input_error(json_file):
                    out = sys.stdout if to_stdout else stack.enter_context(new_table(json_file))
                shows.append((PLAIN_PERIOD, partial(_write_json, out)))
            if to_stdout:
                pass
            elif plain or not drawn:
                shows.append((PLAIN_PERIOD, _plain(sys.stdout)))
            else:
                live = Live(console=console, screen=True, auto_refresh=False)
                shows.append((PERIOD, partial(_picture, stack.enter_context(live))))
            _follow(listener, shows)
    except RuntimeError:
        if rclpy.ok():
            raise
        # Shutdown during a call into rclpy.
    finally:
        rclpy.try_shutdown()
    if multiprocessing.parent_process() is None:
        print(printable(_ending(listener.data)), file=sys.stderr)


def _ending(data: LiveData) -> str:
    if not data.received:
        return f"evpinn: {NOTHING}"
    return (
        "evpinn: the view has ended and saved nothing; the nodes go on. To keep a drive and what "
        "was learned: evpinn run --record FOLDER --state FILE"
    )


def _picture(live: Live, data: LiveData, now: float) -> None:
    live.update(screen(data, now, *live.console.size), refresh=True)


def _plain(out: TextIO) -> Show:
    shown: list[str] = []

    def show(data: LiveData, now: float) -> None:
        problems = problem_lines(data, now)
        for line in problems:
            if line not in shown:
                print(printable(line), file=out)
        shown[:] = problems
        print(printable(plain_line(data, now)), file=out, flush=True)

    return show


def _write_json(out: TextIO, data: LiveData, now: float) -> None:
    print(json_text({"time_s": time.time(), **as_json(data, now)}), file=out, flush=True)


def _follow(listener: LiveListener, shows: Sequence[tuple[float, Show]]) -> None:
    parent = multiprocessing.parent_process()
    due = [time.monotonic()] * len(shows)
    while rclpy.ok() and (parent is None or parent.is_alive()):
        listener.take_all()
        now = time.monotonic()
        for index, (period, show) in enumerate(shows):
            if now >= due[index]:
                show(listener.data, now)
                due[index] = max(due[index] + period, now)
        time.sleep(min(max(min(due) - time.monotonic(), 0.0), PERIOD))


@contextmanager
def live_view(units: Units) -> Iterator[None]:
    """Show the nodes of this process from another process; prints stderr after the view ended."""
    # Spawned, not forked: ROS and torch have threads.
    view = multiprocessing.get_context("spawn").Process(
        target=watch, args=(NAMESPACE, units), daemon=True
    )
    # Ctrl-C reaches the view too; it inherits that SIGINT is ignored until its imports are done.
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        view.start()
    finally:
        signal.signal(signal.SIGINT, handler)
    terminal = os.dup(2)
    with tempfile.TemporaryFile() as kept:
        os.dup2(kept.fileno(), 2)
        try:
            yield
        finally:
            view.terminate()
            view.join(END_TIMEOUT)
            view.kill()  # it may hang in a stopped terminal; harmless if it has ended
            os.dup2(terminal, 2)
            os.close(terminal)
            kept.seek(0)
            for line in kept.read().decode(errors="replace").splitlines():
                print(printable(line), file=sys.stderr)
