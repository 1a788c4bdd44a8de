"""Groups of commands that import a command's module only when it is called."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from importlib import import_module
from importlib.abc import SourceLoader
from importlib.util import find_spec
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from evpinn_ros.common.errors import near_names

BRIEF = {  # typer's own texts do not fit on a line
    "help": "Show this help.",
    "install_completion": "Let the shell complete commands.",
    "show_completion": "Print the completion script.",
}


class Readable:
    """Help that joins the lines of each paragraph of a docstring before it wraps them."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.help: str | None = "\n\n".join(
            " ".join(paragraph.split()) for paragraph in (self.help or "").split("\n\n")
        )

    def get_params(self, ctx: Any) -> Any:
        """Parameters of the command; those that typer adds get the texts of `BRIEF`."""
        parameters = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            parameter.help = BRIEF.get(parameter.name, getattr(parameter, "help", None))
        return parameters


class ReadableCommand(Readable, TyperCommand):
    """A command with `Readable` help."""


class ReadableGroup(Readable, TyperGroup):
    """A group of commands with `Readable` help."""


class LazyCommands(ReadableGroup):
    """Imports a command when it is called: torch alone takes more than a second."""

    modules: ClassVar[Mapping[str, str]] = {}
    """Module of each command, in the order of the help; it defines a function or a `typer.Typer`
    with the command's name."""

    _listing = False

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the commands in the order of the help."""
        return [name.replace("_", "-") for name in self.modules]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command `cmd_name`, or None."""
        name = cmd_name.replace("-", "_")
        if name not in self.modules:
            return None
        if self._listing:
            return TyperCommand(cmd_name, help=_described(self.modules[name], name))
        command = getattr(import_module(self.modules[name]), name)
        if isinstance(command, typer.Typer):
            group = typer.main.get_group(command)
            group.name = cmd_name  # the name in the help
            return group
        single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        single.command(cmd_name, cls=ReadableCommand)(command)
        return typer.main.get_command(single)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Resolve arguments to a command; the error for an unknown one lists similar names."""
        near = near_names(args[0], self.list_commands(ctx))
        if near and not ctx.resilient_parsing and self.get_command(ctx, args[0]) is None:
            ctx.fail(f"No such command '{args[0]}'{near}.")
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Completions of commands and options, without importing every command."""
        self._listing = True
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self._listing = False

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help with the first paragraph of each command, without importing it."""
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False


def _described(module: str, name: str) -> str:
    """First paragraph of a command's docstring, read from its source to avoid the import."""
    spec = find_spec(module)
    if spec is None or not isinstance(spec.loader, SourceLoader):
        return ""
    for node in ast.parse(spec.loader.get_source(module) or "").body:
        if not isinstance(node, ast.FunctionDef):
            continue
        decorators = {ast.unparse(decorator) for decorator in node.decorator_list}
        if node.name == name or f"{name}.callback()" in decorators:
            return " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
    return ""
