"""Regular expressions take time that grows with their text and not with its square.

Every expression of the package is tried, found in its source; those whose text is cut before name
how long it can be.
"""

import ast
from functools import cache
from pathlib import Path
import re
import time

import pytest

PACKAGE = Path(__file__).parents[1] / "evpinn_ros"
LONGEST = 40_000  # characters tried
MOST = 0.3  # s of the processor for three searches: linear ones take 0.01, square ones more than 1
CUT = {  # characters of the text that an expression sees, where it is cut before
    "evpinn_ros/logs/clock_start.py": 200,  # `LONGEST_COMMENT`, and a name of a file
    "evpinn_ros/logs/quantities.py": 2000,  # a name of a column: `LONG_LINE`, `LONGEST_CELL`
    "evpinn_ros/logs/numbers.py": 2000,  # a cell
}
MATCHED = ("evpinn_ros/common/yaml_section.py",)  # tried at the begin of a text alone, by PyYAML
PIECES = [
    " ",
    "a",
    "1",
    "_",
    "-",
    "+1",
    "1.",
    ",000",
    ".",
    ":",
    "[",
    "(",
    "]",
    "//",
    "\n",
    " a",
    "1 ",
]
PIECES += [
    "start",
    "BO_ ",
    "BO_ 1 ",
    "SG_ ",
    "SG_ a m",
    "SG_MUL_VAL_ 1",
    "VIRTUAL",
    "ELM",
    "aA",
    "\0",
]
STARTS = [
    "",
    "start",
    "BO_ ",
    "BO_ 1 a",
    "SG_ a m1",
    "SG_MUL_VAL_ 1",
    ": ",
    "[",
    "//",
    "\x01aaaa\0\0\0\0",
]


def _expressions():
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text())
        constants = {
            target.id: node.value.value
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            if ast.unparse(call.func).startswith("re.") and call.args:
                first = call.args[0]
                pattern = getattr(first, "value", None) or constants.get(getattr(first, "id", ""))
                if isinstance(first, ast.JoinedStr):
                    pattern = "".join(
                        each.value if isinstance(each, ast.Constant) else "a"
                        for each in first.values
                    )
                if isinstance(pattern, str | bytes):
                    yield str(path.relative_to(PACKAGE.parent)), pattern


@cache
def expressions():
    """Every file and its expressions, in order; not while tests are collected: it takes 2 s."""
    return sorted(set(_expressions()), key=repr)


def _flags(pattern):
    """Lines have a begin where an expression asks for it."""
    return re.MULTILINE if pattern[:1] in ("^", b"^") else 0


def _methods(path, compiled):
    return (compiled.match,) if path in MATCHED else (compiled.search, compiled.findall)


def test_the_expressions_are_found():
    assert len(expressions()) > 20 and {path for path, _ in expressions()} >= set(CUT)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_no_expression_takes_the_square_of_its_text():
    slow = []
    for path, pattern in expressions():
        compiled, length = re.compile(pattern, _flags(pattern)), CUT.get(path, LONGEST)
        worst = 0.0
        for start in STARTS:
            for piece in PIECES:
                text = (start + piece * (length // len(piece)))[:length] + "\x7f"
                given = text.encode() if isinstance(pattern, bytes) else text
                begin = time.process_time()
                for method in _methods(path, compiled):
                    method(given)
                worst = max(worst, time.process_time() - begin)
                if worst > MOST:
                    break
            if worst > MOST:
                break
        if worst > MOST:
            slow.append((path, pattern, round(worst, 2)))
    assert not slow
