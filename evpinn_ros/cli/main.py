"""The command `evpinn`: its subcommands, and how errors end it."""

from __future__ import annotations

import os
import sys

import typer

from evpinn_ros import __version__
from evpinn_ros.cli.interruption import INTERRUPTED
from evpinn_ros.cli.lazy import LazyCommands
from evpinn_ros.errors import InputError

FAILED = 1


class Commands(LazyCommands):
    """The subcommands of `evpinn`."""

    names = (
        *("replay", "run", "watch", "view", "convert", "simulate", "reproduce", "fleet"),
        *("bench", "demo"),
        *("info", "recover"),
        "can",
        "check_params",
    )


app = typer.Typer(cls=Commands, no_args_is_help=True, pretty_exceptions_enable=False)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def evpinn(
    version: bool = typer.Option(
        False, "--version", is_eager=True, callback=_print_version, help="Print the version."
    ),
) -> None:
    """Learn an electric car's parameters, power and energy from its CAN bus, while it drives.

    Example: evpinn replay bags/urban --vehicle tesla_model_3_lr
    """


def main() -> None:
    """Run the command; wrong input is one line on stderr and exit code 1."""
    try:
        app()
    except InputError as error:
        print(f"evpinn: {error}", file=sys.stderr)
        sys.exit(FAILED)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output has gone, as `head` does; there is nobody left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(FAILED)


if __name__ == "__main__":
    main()
