"""`evpinn bench`: the benchmarks of this project, against peers."""

from __future__ import annotations

import typer

from evpinn_ros.cli.lazy import LazyCommands

COMMANDS = (
    "training",
    "online",
    "carried",
    "unseen",
    "ablation",
    "settings",
    "truth",
    "can",
    "energy",
    "soak",
    "fleet",
    "fuzz",
    "report",
    "recover",
    "logs",
    "vehicles",
    "faults",
)  # each a function in `bench_<name>.py`


class BenchCommands(LazyCommands):
    """The subcommands of `evpinn bench`."""

    names = COMMANDS
    prefix = "bench_"


bench = typer.Typer(
    cls=BenchCommands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@bench.callback()
def about() -> None:
    """Measure this project against its peers.

    Example: evpinn bench online bags/urban --vehicle tesla_model_3_lr
    """
