"""`evpinn bench`: the benchmarks of this project, available only in a checkout."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import sys
from typing import Any, ClassVar

import typer

from evpinn_ros.cli.lazy import LazyCommands
from evpinn_ros.common.errors import InputError

CHECKOUT = Path(__file__).resolve().parents[2]

COMMANDS = ("unseen", "ablation", "settings", "plans", "truth", "breakdown", "speed", "soak")


class BenchCommands(LazyCommands):
    """The subcommands of `evpinn bench`."""

    modules: ClassVar[Mapping[str, str]] = {name: f"benchmarks.cli.{name}" for name in COMMANDS}

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The benchmark `cmd_name`, or None; InputError outside a checkout."""
        if not (CHECKOUT / "benchmarks" / "cli").is_dir():
            raise InputError("the benchmarks are not installed; run evpinn bench in a checkout")
        if str(CHECKOUT) not in sys.path:
            sys.path.append(str(CHECKOUT))
        return super().get_command(ctx, cmd_name)


bench = typer.Typer(
    cls=BenchCommands, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


@bench.callback()
def about() -> None:
    """Benchmark this package against other methods.

    Example: evpinn bench unseen bags=tesla_model_3_lr --methods prior,core
    """
