"""Help of every command: an example that the command line takes, one meaning, whole lines."""

from collections.abc import Iterator
from pathlib import Path
import re
import shlex

import pytest
import typer
from typer.testing import CliRunner

from evpinn_ros.cli.main import app
from evpinn_ros.cli.options import complete_profile, complete_vehicle

ROOT = typer.main.get_command(app)


def commands(command=ROOT, path: str = "evpinn") -> Iterator[tuple[str, object]]:
    yield path, command
    if hasattr(command, "list_commands"):
        context = command.make_context(path, [], resilient_parsing=True)
        for name in command.list_commands(context):
            subcommand = command.get_command(context, name)
            assert subcommand is not None, f"{path} lists {name}"
            yield from commands(subcommand, f"{path} {name}")


COMMANDS = dict(commands())


def examples(command) -> list[str]:
    """The commands after `Example:` in a docstring, each to the end of its paragraph."""
    paragraphs = re.split(r"\n\s*\n", command.help or "")
    texts = [" ".join(text.split()) for text in paragraphs]
    return [text.removeprefix("Example: ") for text in texts if text.startswith("Example: ")]


def parse(command, words: list[str], parent=None) -> str:
    """The path of the command that the words are for; raises what the shell would show."""
    context = command.make_context(words[0], words[1:], parent=parent)
    if not hasattr(command, "resolve_command"):
        return words[0]
    name, subcommand, rest = command.resolve_command(context, words[1:])
    return f"{words[0]} {parse(subcommand, [name, *rest], context)}"


@pytest.mark.parametrize("path", COMMANDS)
def test_help_shows_an_example_that_the_command_line_takes(path: str) -> None:
    shown_examples = examples(COMMANDS[path])
    assert shown_examples, (
        f"evpinn_ros/cli: the docstring of `{path}` has no paragraph `Example: {path} ...`"
    )
    used = [
        parse(ROOT, shlex.split(line)) for text in shown_examples for line in text.split(" && ")
    ]
    assert any(path_used == path or path_used.startswith(f"{path} ") for path_used in used)
    shown = CliRunner().invoke(app, [*path.split()[1:], "--help"], terminal_width=300)
    for text in shown_examples:
        assert text in " ".join(shown.output.split())


@pytest.mark.parametrize("path", COMMANDS)
def test_names_complete_wherever_they_are_asked_for(path: str) -> None:
    """An option of another spelling than these: evpinn_ros.cli.options has them ready."""
    offered = {"vehicle": complete_vehicle(""), "can_profile": complete_profile("")}
    command = COMMANDS[path]
    context = command.make_context(path, [], resilient_parsing=True)
    for parameter in command.params:
        if parameter.name in offered:
            items = [item.value for item in parameter.shell_complete(context, "")]
            assert items == offered[parameter.name], f"{path} --{parameter.name}"


@pytest.mark.parametrize("path", COMMANDS)
def test_json_is_a_file_or_stdout_and_never_an_input(path: str, tmp_path: Path) -> None:
    """`--json drive.csv` is the slip of who forgot the file's name: the drive stays."""
    (tmp_path / "drive.csv").write_text("t_s,speed_mps\n")
    for parameter in COMMANDS[path].params:
        if "--json" in parameter.opts:
            context = COMMANDS[path].make_context(path, [], resilient_parsing=True)
            for given in ("-", str(tmp_path / "new.json")):
                assert parameter.process_value(context, given) == Path(given)
            context.resilient_parsing = False
            with pytest.raises(typer.BadParameter, match=r"only \.json files"):
                parameter.process_value(context, str(tmp_path / "drive.csv"))


def test_a_table_of_metrics_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("input.path,totals.start\ndrive.csv,\n")
    replay = COMMANDS["evpinn replay"]
    (metrics,) = (parameter for parameter in replay.params if "--metrics" in parameter.opts)
    context = replay.make_context("replay", ["drive.csv"])
    assert metrics.process_value(context, str(tmp_path / "m.csv")) == tmp_path / "m.csv"
    (tmp_path / "m_trends.csv").write_text("t_s,speed_mps\n")
    with pytest.raises(typer.BadParameter, match=r"m_trends\.csv exists"):
        metrics.process_value(context, str(tmp_path / "m.csv"))


@pytest.mark.parametrize("width", [80, 100])
@pytest.mark.parametrize("path", COMMANDS)
def test_no_help_is_wider_than_the_terminal(path: str, width: int) -> None:
    shown = CliRunner(env={"COLUMNS": str(width)}).invoke(app, [*path.split()[1:], "--help"])
    assert shown.exit_code == 0 and max(map(len, shown.output.splitlines())) <= width
