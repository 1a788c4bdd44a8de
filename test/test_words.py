"""Words of docs/explanation/glossary.md in the package: one thing, one word, the field's."""

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
import io
from pathlib import Path
import re
import tokenize

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "evpinn_ros"
FILES = {
    str(path.relative_to(ROOT)).removeprefix("evpinn_ros/"): path
    for folder in (PACKAGE, ROOT / "benchmarks")
    for path in sorted(folder.rglob("*.py"))
}

QUESTIONS = re.compile(
    r"(What|Whether|How|Which|Who|Why|Where|When|All that|Of|The same|Likewise|See the module)\b"
)
"""Beginnings of docstrings that do not name their thing: a noun or a verb phrase does."""

GONE = {
    "adopt", "adopted", "belief", "beliefs", "believe", "believed", "believes", "flicker",
    "foretell", "foretells", "foretold", "hear", "heard", "hears", "keeper", "nobody", "said",
    "silence", "silences", "surprise", "surprised", "told", "unheard",
}  # fmt: skip
"""The glossary's words that went: in names (parts between underscores) and in docstrings."""
GONE_NAMES = GONE | {"null", "nulls", "push", "noticed"}
GONE_PHRASES = ("held against", "speaks of", "clock that never jumps", "silent battery")

KEPT = {("benchmarks/cli/fuzz.py", "said"), ("benchmarks/faults/fault.py", "said")}
"""Names that are keys of `--json` or of saved states, which are fixed."""

PATH = re.compile(r"(?<![\w/.:{<*])((?:[\w.-]+/)+[\w-]+\.(?:py|md|yaml|csv|js|sh|toml)|\w+\.md)\b")
HOMES = (ROOT, PACKAGE, ROOT / "docs", ROOT / "test")


@cache
def tree_of(file: str) -> ast.Module:
    return ast.parse(FILES[file].read_text())


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


def test_a_docstring_begins_with_its_thing() -> None:
    texts = [(file, *found) for file in FILES for found in documented(tree_of(file))]
    assert [each for each in texts if QUESTIONS.match(each[-1])] == []


def test_a_docstring_of_a_test_begins_with_its_thing() -> None:
    """A sentence of a test may ask; none hangs on the name above it."""
    hanging = re.compile(r"(Of|The same|Likewise|See the module)\b")
    for path in sorted((ROOT / "test").rglob("*.py")):
        texts = [text for _, text in documented(ast.parse(path.read_text()))]
        assert [text for text in texts if hanging.match(text)] == [], path


def gone(file: str) -> Iterator[tuple[str, int, str]]:
    """Place and text of what should not be there."""
    kept = {word for where, word in KEPT if where == file}
    for line, name in names(tree_of(file)):
        if parts(name) & (GONE_NAMES - kept):
            yield file, line, name
    for line, text in documented(tree_of(file)):
        plain = re.sub(r"`[^`]*`|^ +\w+:", "", text, flags=re.MULTILINE)
        words = {each.lower() for each in re.findall(r"\w+", plain)}
        phrases = [phrase for phrase in GONE_PHRASES if phrase in " ".join(plain.split())]
        yield from ((file, line, found) for found in (*(words & GONE), *phrases))


def test_words_that_went_stay_away() -> None:
    assert [found for file in FILES for found in gone(file)] == []


def test_no_exception_is_left_over() -> None:
    """A word that a file no longer has needs no exception."""
    for file, word in KEPT:
        assert any(word in parts(name) for _, name in names(tree_of(file)))


def test_no_two_things_have_one_name() -> None:
    """A class has a name of its own, in whatever room or benchmark it lies."""
    found = Counter(
        node.name
        for file in FILES
        for node in tree_of(file).body
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in found.items() if count > 1] == []


def missing(file: str) -> Iterator[tuple[str, str]]:
    """Paths that a file names and that are nowhere."""
    texts = [text for _, text in documented(tree_of(file))]
    tokens = tokenize.generate_tokens(io.StringIO(FILES[file].read_text()).readline)
    texts += [token.string for token in tokens if token.type == tokenize.COMMENT]
    homes = (*HOMES, FILES[file].parent)
    for named in {found for text in texts for found in PATH.findall(text)}:
        if not any((home / named).exists() for home in homes):
            yield file, named


def test_paths_in_docstrings_and_comments_exist() -> None:
    assert [found for file in FILES for found in missing(file)] == []
