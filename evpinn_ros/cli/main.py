"""The command `evpinn`: its subcommands, and how errors end it."""

from __future__ import annotations

import os
import sys

import typer

from evpinn_ros import __version__
from evpinn_ros.cli.check_params import check_params
from evpinn_ros.cli.convert import convert
from evpinn_ros.cli.demo import demo
from evpinn_ros.cli.replay import replay
from evpinn_ros.cli.run import run
from evpinn_ros.cli.simulate import simulate
from evpinn_ros.errors import InputError

FAILED = 1

app = typer.Typer(
    help="Learn an electric car's parameters, power and energy from its CAN bus, while driving.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (replay, run, convert, simulate, demo):
    app.command()(command)
app.command("check-params")(check_params)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(
        False, "--version", is_eager=True, callback=_print_version, help="Print the version."
    ),
) -> None:
    """Options of the command itself."""


def main() -> None:
    """Run the command; wrong input is one line on stderr and exit code 1."""
    try:
        app()
    except InputError as error:
        print(f"evpinn: {error}", file=sys.stderr)
        sys.exit(FAILED)
    except BrokenPipeError:
        # Whoever read our output has gone, as `head` does; there is nobody left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(FAILED)


if __name__ == "__main__":
    main()
