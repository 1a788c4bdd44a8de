"""The command `evpinn`: its subcommands, and how errors end it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from io import TextIOWrapper
import os
import sys
from typing import ClassVar

import typer

from evpinn_ros import __version__
from evpinn_ros.cli.console import note, say
from evpinn_ros.cli.interruption import INTERRUPTED
from evpinn_ros.cli.lazy import LazyCommands
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.optional import optional_imports

FAILED = 1


EXTRAS = {
    "export": "evpinn_ros.extras.export",
    "mqtt": "evpinn_ros.extras.bridges.mqtt",
    "vss": "evpinn_ros.extras.bridges.vss",
    "reproduce": "evpinn_ros.extras.paper.reproduce",
    "fleet": "evpinn_ros.extras.fleet.fleet",
}
"""Commands implemented in `extras`; nothing else in the package refers to it."""

NAMES = (
    *("replay", "compare", "forecast", "export", "run", "mqtt", "vss", "watch", "view"),
    *("convert", "simulate", "reproduce", "fleet", "bench", "demo", "info", "recover"),
    *("can", "vehicles", "check_params"),
)


class Commands(LazyCommands):
    """The subcommands of `evpinn`."""

    modules: ClassVar[Mapping[str, str]] = {
        name: EXTRAS.get(name, f"evpinn_ros.cli.{name}") for name in NAMES
    }


app = typer.Typer(cls=Commands, no_args_is_help=True, pretty_exceptions_enable=False)


def _print_version(wanted: bool) -> None:
    if wanted:
        say(__version__)
        raise typer.Exit


@app.callback()
def evpinn(
    version: bool = typer.Option(
        False, "--version", is_eager=True, callback=_print_version, help="Print the version."
    ),
) -> None:
    """Learn from a car's data where its energy goes, and what a trip will take.

    Example: evpinn replay bags/urban --vehicle tesla_model_3_lr
    """


def main(signals: AbstractContextManager[None] = nullcontext()) -> None:  # noqa: B008
    """Run the command line inside the context `signals`; an error is one line and exit code 1."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # for terminals without UTF-8
    try:
        try:
            with signals, optional_imports():
                app()
        finally:
            sys.stdout.flush()  # raises now if the disk is full, not at exit
    except InputError as error:
        note(f"evpinn: {error}")
        sys.exit(FAILED)
    except MemoryError:
        note("evpinn: out of memory")
        sys.exit(FAILED)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        _drop_output()  # the reader, such as `head`, has ended
        sys.exit(FAILED)
    except OSError as error:
        _drop_output()
        note(f"evpinn: {error.filename or 'the output'}: {error.strerror or error}")
        sys.exit(FAILED)


def _drop_output() -> None:
    """Discard buffered stdout, which Python would otherwise write at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
