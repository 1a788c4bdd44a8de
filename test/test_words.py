"""Words of docs/explanation/glossary.md in the package: one thing, one word, the field's."""

import ast
from collections.abc import Iterator
import io
from pathlib import Path
import re
import tokenize

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "evpinn_ros"
FILES = {
    str(path.relative_to(ROOT)).removeprefix("evpinn_ros/"): path
    for folder in (PACKAGE, ROOT / "benchmarks")
    for path in sorted(folder.rglob("*.py"))
}

QUESTIONS = re.compile(r"(What|Whether|How|Which|Who|Why|Where|When|All that)\b")
"""Beginnings of a docstring that does not name its thing: a noun or a verb phrase does."""

GONE = {
    "adopt", "adopted", "belief", "beliefs", "believe", "believed", "believes", "flicker",
    "foretell", "foretells", "foretold", "hear", "heard", "hears", "keeper", "nobody", "said",
    "silence", "silences", "surprise", "surprised", "told", "unheard",
}  # fmt: skip
"""The glossary's words that went: in names (parts between underscores) and in docstrings."""
GONE_NAMES = GONE | {"null", "nulls", "push", "noticed"}
GONE_PHRASES = ("held against", "speaks of", "clock that never jumps", "silent battery")

KEPT = {("benchmarks/fuzz.py", "said"), ("benchmarks/faults/fault.py", "said")}
KEPT |= {("benchmarks/bridge_load.py", "heard"), ("signals/sign_detectors.py", "told")}
"""Names that are keys of `--json` or of saved states, which are fixed."""

PATH = re.compile(r"(?<![\w/.:{<*])((?:[\w.-]+/)+[\w-]+\.(?:py|md|yaml|csv|js|sh|toml)|\w+\.md)\b")
HOMES = (ROOT, PACKAGE, ROOT / "docs", ROOT / "test")


def documented(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring, those below a constant or an attribute too."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield node.lineno, text


def names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and name of all that the code defines; what it uses is named elsewhere."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


def parts(name: str) -> set[str]:
    """Words of a name, by underscores and capitals."""
    return {each.lower() for each in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


@pytest.mark.parametrize("file", FILES)
def test_a_docstring_begins_with_its_thing(file: str) -> None:
    tree = ast.parse(FILES[file].read_text())
    assert [(line, text) for line, text in documented(tree) if QUESTIONS.match(text)] == []


@pytest.mark.parametrize("file", FILES)
def test_words_that_went_stay_away(file: str) -> None:
    tree = ast.parse(FILES[file].read_text())
    kept = {word for where, word in KEPT if where == file}
    found = [(line, name) for line, name in names(tree) if parts(name) & (GONE_NAMES - kept)]
    for line, text in documented(tree):
        plain = re.sub(r"`[^`]*`|^ +\w+:", "", text, flags=re.MULTILINE)
        words = {each.lower() for each in re.findall(r"\w+", plain)}
        found += [(line, word) for word in words & GONE]
        found += [(line, phrase) for phrase in GONE_PHRASES if phrase in " ".join(plain.split())]
    assert found == []


def test_no_exception_is_left_over() -> None:
    """A word that a file no longer has needs no exception."""
    for file, word in KEPT:
        assert any(word in parts(name) for _, name in names(ast.parse(FILES[file].read_text())))


@pytest.mark.parametrize("file", sorted(FILES))
def test_paths_in_docstrings_and_comments_exist(file: str) -> None:
    source = FILES[file].read_text()
    texts = [text for _, text in documented(ast.parse(source))]
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    texts += [token.string for token in tokens if token.type == tokenize.COMMENT]
    homes = (*HOMES, FILES[file].parent)
    named = {found for text in texts for found in PATH.findall(text)}
    assert {each for each in named if not any((home / each).exists() for home in homes)} == set()
