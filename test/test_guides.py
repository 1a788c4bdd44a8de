"""Commands in the docs work as they stand.

Of the README and the guides every block of bash is run, in a folder with nothing but what the
checkout brings, or says why it is not: `<!-- not run: needs an adapter -->` on the line before it.
What a page shows as output is what came out, its numbers to 1 %. In all pages every `evpinn`
command is one that the command line takes.
"""

from collections.abc import Iterator
import itertools
from itertools import pairwise
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
from typing import NamedTuple

import pytest
import typer

from evpinn_ros.cli.main import app

pytestmark = pytest.mark.build

ROOT = Path(__file__).parents[1]
GUIDES = [ROOT / "README.md", *sorted((ROOT / "docs" / "guides").glob("*.md"))]
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [*DOCS, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
LONG = {"add_your_car", "compare", "fleet", "obd", "plan", "python", "replay", "rmf"}
LONG |= {"robot", "uncertainty", "viewing"}
NOTHING_RUNS = {"planning", "ros"}  # their blocks need ROS, nodes or a window
NUMBER = re.compile(r"[-+]?\d[\d.]*")
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
REASON = re.compile(r"<!-- not run: (\S.*) -->\n\Z")
COMMAND = typer.main.get_command(app)


class Block(NamedTuple):
    """A block of bash, why it is not run, and the output that the page shows for it."""

    text: str
    reason: str | None
    shown: str


def blocks(page: str) -> Iterator[Block]:
    for block, following in pairwise([*FENCED.finditer(page), None]):
        if block[1] != "bash":
            continue
        reason = REASON.search(page[: block.start()])
        is_output = (
            following is not None
            and following[1] == ""
            and not page[block.end() : following.start()].strip()
        )
        yield Block(block[2], reason and reason[1], following[2] if is_output else "")


def commands(text: str) -> Iterator[list[str]]:
    """The words of each evpinn command in a block."""
    for line in text.replace("\\\n", " ").splitlines():
        if not re.search(r"\bevpinn ", line):
            continue
        lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
        lexer.whitespace_split = True
        words = [*lexer, ";"]
        while "evpinn" in words:
            words = words[words.index("evpinn") :]
            end = next(i for i, word in enumerate(words) if set(word) <= set("();<>|&"))
            yield words[:end]
            words = words[end:]


def parse(words: list[str]) -> None:
    """Raises what the shell would show for a command line that is wrong; runs nothing."""
    command = COMMAND
    words = [word for word in words if word != "--help"]
    while hasattr(command, "get_command"):
        context = command.make_context(words[0], [], resilient_parsing=True)
        words = words[1:]
        if not words or words[0].startswith("-"):  # an option of the group acts when it is parsed
            return
        command = command.get_command(context, words[0])
        assert command is not None, f"no command {words[0]}"
    command.make_context(words[0], words[1:])


class Line(NamedTuple):
    """A line of output without the width of its columns: its text, # for a number, and numbers."""

    text: str
    numbers: tuple[str, ...]

    def is_shown_by(self, shown: "Line") -> bool:
        """Whether a page shows it: what machines round differently is less than 1 %."""
        pairs = zip(self.numbers, shown.numbers, strict=False)
        return self.text == shown.text and all(itertools.starmap(is_near, pairs))


def lines(text: str) -> list[Line]:
    plain = (" ".join(line.split()).strip(" ─") for line in text.splitlines())
    return [Line(NUMBER.sub("#", line), tuple(NUMBER.findall(line))) for line in plain]


def is_near(came: str, shown: str) -> bool:
    """Within 1 %, or one of the last digit that is shown."""
    if came.count(".") > 1 or shown.count(".") > 1:  # a date
        return True
    digits = len(shown.partition(".")[2].strip("."))
    most = max(0.01 * abs(float(shown.strip("."))), 10.0**-digits)
    return abs(float(came.strip(".")) - float(shown.strip("."))) <= most * (1 + 1e-9)


@pytest.fixture
def checkout(tmp_path) -> Path:
    """What a newcomer has who followed "Try it": the files, `evpinn` and `python` on the path."""
    for name in ("bags", "config", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name)
    (tmp_path / ".bin").mkdir()
    for name, module in (("python", ""), ("evpinn", "-m evpinn_ros")):
        script = tmp_path / ".bin" / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" {module} "$@"\n')
        script.chmod(0o755)
    return tmp_path


def guides():
    for page in GUIDES:
        marks = [pytest.mark.nightly] if page.stem in LONG else []
        yield pytest.param(page, id=page.stem, marks=marks)


@pytest.mark.parametrize("page", list(guides()))
def test_blocks_run_as_they_stand(page, checkout):
    environment = {
        **os.environ,
        "PATH": f"{checkout / '.bin'}:{os.environ['PATH']}",
        "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}",
        "COLUMNS": "100",
        "OMP_NUM_THREADS": "1",
    }
    ran = [block for block in blocks(page.read_text()) if block.reason is None]
    assert bool(ran) == (page.stem not in NOTHING_RUNS), "a page of which nothing is run"
    for block in ran:
        ended = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block.text],
            cwd=checkout,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=150,
        )
        assert ended.returncode == 0, f"{block.text}\n{ended.stdout}{ended.stderr}"
        came = lines(ended.stdout + ended.stderr)
        missing = [
            shown
            for shown in lines(block.shown)
            if shown.text not in ("...", "") and not any(line.is_shown_by(shown) for line in came)
        ]
        assert not missing, f"{block.text}\n{missing}\nis not in\n{ended.stdout}{ended.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_are_ones_that_the_command_line_takes(page):
    for block in blocks(page.read_text()):
        for words in commands(block.text):
            try:
                parse(words)
            except Exception as error:
                pytest.fail(f"{shlex.join(words)}: {error}")


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.stem)
def test_every_fence_is_one_that_is_understood(page):
    text = page.read_text()
    fences = FENCED.findall(text)
    assert {language for language, _ in fences} <= {"bash", "csv", "python", "yaml", ""}
    assert text.count("```") == 2 * len(fences), "indented, or not closed: it would not be run"
