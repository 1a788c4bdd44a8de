"""No test depends on the speed of the machine: each waits for a condition (`waiting.py`)."""

from __future__ import annotations

import ast
from pathlib import Path
import re

import pytest

from test.waiting import wait_until

ROOT = Path(__file__).parent
OURS = (Path(__file__), ROOT / "waiting.py")

LEAST_S = 60.0
"""The shortest timeout that only ends a hang."""

SLEEP = re.compile(r"\bsleep\(")
CLOCK = re.compile(r"\b(perf_counter|monotonic|process_time|elapsed)(_ns)?\b")
BOUNDED = {"communicate": 1, "join": 0, "result": 0, "run": None, "wait": 0}
"""Calls that end after a timeout, with its position among the arguments."""


def violations(source: str) -> list[str]:
    """Returns what a file of tests does with time, each with its line number."""
    lines = [
        f"{number}: sleeps: {line.strip()}"
        for number, line in enumerate(source.splitlines(), 1)
        if SLEEP.search(line)
    ]
    nodes = [*ast.walk(ast.parse(source))]
    durations = {name for node in nodes for name in names_of_durations(node)}
    for node in nodes:
        if isinstance(node, ast.Assert) and (
            CLOCK.search(ast.unparse(node.test)) or durations & names_in(node.test)
        ):
            lines.append(f"{node.lineno}: asserts on a duration: {ast.unparse(node.test)}")
        if isinstance(node, ast.Call) and (timeout := short_timeout(node)) is not None:
            lines.append(f"{node.lineno}: gives up after {timeout} s: {ast.unparse(node)}")
    return lines


def names_in(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def names_of_durations(node: ast.AST) -> set[str]:
    """Returns the name that a statement gives to a difference of a clock's times."""
    if not isinstance(node, ast.Assign) or not CLOCK.search(ast.unparse(node.value)):
        return set()
    differs = any(isinstance(part, ast.Sub) for part in ast.walk(node.value))
    return {t.id for t in node.targets if differs and isinstance(t, ast.Name)}


def short_timeout(call: ast.Call) -> float | None:
    """Returns the timeout of a blocking call in s where it could end a test that does not hang."""
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    if name == "settings":  # of Hypothesis: ms for an example
        values = [keyword.value for keyword in call.keywords if keyword.arg == "deadline"]
        return next((0.001 * value.value for value in values if is_number(value)), None)
    if name not in BOUNDED and name != "wait_until":
        return None
    place = BOUNDED.get(name, 1)
    values = [keyword.value for keyword in call.keywords if keyword.arg == "timeout"]
    if place is not None and len(call.args) > place:
        values.append(call.args[place])
    numbers = [ast.literal_eval(value) for value in values if is_number(value)]
    return next((number for number in numbers if number < LEAST_S), None)


def is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def files() -> list[Path]:
    return sorted(path for path in ROOT.rglob("*.py") if path not in OURS)


def test_no_test_depends_on_the_speed_of_the_machine() -> None:
    texts = [
        f"{path.relative_to(ROOT.parent)}:{line}"
        for path in files()
        for line in violations(path.read_text())
    ]
    assert not texts, "wait for a condition (test/waiting.py):\n" + "\n".join(texts)


def test_waiting_ends_with_the_condition() -> None:
    values = iter([0, [], None, "text"])
    assert wait_until(lambda: next(values), meanwhile=lambda: None) == "text"


def test_a_hang_is_reported() -> None:
    with pytest.raises(AssertionError, match="nothing came"):
        wait_until(lambda: False, timeout=-1.0, report=lambda: "nothing came")
