"""The command `evpinn`: its subcommands, and how errors end it."""

from __future__ import annotations

from importlib import import_module
import os
import sys
from typing import Any

import typer
from typer.core import TyperGroup

from evpinn_ros import __version__
from evpinn_ros.errors import InputError

FAILED = 1
# Each is a function of the same name in a module of this package.
COMMANDS = ("replay", "run", "convert", "simulate", "reproduce", "demo", "check_params")


class LazyCommands(TyperGroup):
    """Imports a command when it is asked for: torch alone takes more than a second."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of the help."""
        return [name.replace("_", "-") for name in COMMANDS]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name, None when there is none."""
        name = cmd_name.replace("-", "_")
        if name not in COMMANDS:
            return None
        function = getattr(import_module(f"evpinn_ros.cli.{name}"), name)
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(cmd_name)(function)
        return typer.main.get_command(alone)


app = typer.Typer(
    cls=LazyCommands, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


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
    """Learn an electric car's parameters, power and energy from its CAN bus, while it drives."""


def main() -> None:
    """Run the command; wrong input is one line on stderr and exit code 1."""
    try:
        app()
    except InputError as error:
        print(f"evpinn: {error}", file=sys.stderr)
        sys.exit(FAILED)
    except KeyboardInterrupt:
        sys.exit(FAILED)
    except BrokenPipeError:
        # Whoever read our output has gone, as `head` does; there is nobody left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(FAILED)


if __name__ == "__main__":
    main()
