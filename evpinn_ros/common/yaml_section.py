"""Strict reading of YAML files written by people: every error names file, line and reason."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
import re
from typing import Any

import yaml

from evpinn_ros.common.errors import InputError, as_input_error, known_names
from evpinn_ros.common.opener import open_file

MAX_FILE_BYTES = 100_000  # PyYAML takes a second for this size
LONGEST_NUMBER = 400  # characters: more than any float has before its point
MOST_NODES = 60_000  # a second for 20 000; metadata of 1 MB with 1000 topics has 40 000
MAX_DEPTH = 20  # of nested lists and mappings; our files need 4, bags' metadata 7

_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_NUMBERS = {
    _INT: re.compile(r"[-+]?(?:0b[01_]+|0x[0-9a-fA-F_]+|0[0-7_]*|[1-9][0-9_]*)$"),
    _FLOAT: re.compile(
        r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?|\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?"
        r"|\.(?:inf|Inf|INF))$|\.(?:nan|NaN|NAN)$"
    ),
}
"""Numbers of PyYAML, except those of base 60."""


def compose(path: Path, title: str, text: str | None = None) -> Section:
    """Read the YAML mapping `path`; InputError names the `title` ("vehicle file").

    text: content that the file will have; it is not read then.
    """
    content = _content(path, title, MAX_FILE_BYTES) if text is None else text
    return Section(path, _root(path, content), title)


def load_plain(path: Path, title: str, most_bytes: int) -> Any:
    """Content of a YAML file as plain Python values; InputError if wrong or above `most_bytes`."""
    node = _root(path, _content(path, title, most_bytes))
    with as_input_error(path, ValueError):
        return plain(node)


def plain_text(text: str) -> Any:
    """Plain values of YAML inside another file, None for an empty text; or ValueError."""
    try:
        node = yaml.compose(text, Loader=_PlainLoader)
    except (yaml.YAMLError, OverflowError) as error:
        raise ValueError(str(error)) from error
    return None if node is None else plain(node)


def plain(node: yaml.Node) -> Any:
    """The plain Python value of a node; ValueError for tags or an impossible date."""
    try:
        return _PlainLoader("").construct_object(node, deep=True)
    except Exception as error:
        # PyYAML trusts tags such as `!!int ""` and `!!timestamp x`, and fails with any kind of
        # error.
        reason = getattr(error, "problem", None) or error
        raise ValueError(f"no plain value: {reason}") from error


class _PlainLoader(yaml.SafeLoader):
    """Refuses small files that expand to much: aliases, endless nesting, numbers of base 60.

    `1:30` is text here, as in YAML 1.2; YAML 1.1 makes a number of it, in a time that grows with
    the square of its length.
    """

    depth = nodes = 0
    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, _NUMBERS.get(tag, form)) for tag, form in rules]
        for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        text = str(node.value)
        if ":" in text or len(text) > LONGEST_NUMBER:
            raise ValueError("not a number in base 10, 16, 8 or 2")
        read = self.construct_yaml_int if node.tag == _INT else self.construct_yaml_float
        number: int | float = read(node)
        return number

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _refusal("aliases (*name) are not read; write it out", event)
        self.nodes += 1
        if self.depth == MAX_DEPTH or self.nodes > MOST_NODES:
            deep = self.depth == MAX_DEPTH
            raise _refusal("nested too deeply" if deep else f"over {MOST_NODES} values", event)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


_PlainLoader.add_constructor(_INT, _PlainLoader.construct_number)
_PlainLoader.add_constructor(_FLOAT, _PlainLoader.construct_number)


def _refusal(problem: str, event: yaml.Event) -> yaml.MarkedYAMLError:
    mark: Any = event.start_mark
    return yaml.composer.ComposerError(None, None, problem, mark)


def _content(path: Path, title: str, most_bytes: int) -> bytes:
    # ValueError: an impossible name of a file.
    with as_input_error(path, ValueError), open_file(path) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise InputError(f"{path}: larger than {most_bytes} bytes, not a {title}")
    return content


def _root(path: Path, content: str | bytes) -> yaml.Node:
    try:
        node = yaml.compose(content, Loader=_PlainLoader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise InputError(f"{path}:{line}: not YAML: {error.problem}") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: not YAML: {error}".replace("\n", " ")) from error
    if node is None:
        raise InputError(f"{path}: the file is empty")
    return node


class Section:
    """One mapping of a file with its line numbers, so that every error can name its line."""

    def __init__(self, path: Path, node: yaml.Node, title: str) -> None:
        self._path, self.node, self._title = path, node, title
        if not isinstance(node, yaml.MappingNode):
            raise self.error(f"{title}: expected 'key: value' lines")
        self._items: dict[str, tuple[yaml.Node, yaml.Node]] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise self.error(f"{title}: a key must be a word", key)
            if key.value in self._items:
                raise self.error(f"'{key.value}' is given twice", key)
            self._items[key.value] = (key, value)

    def error(self, reason: str, node: yaml.Node | None = None) -> InputError:
        """The error to raise for this section, or for one `node` in it."""
        line = (node or self.node).start_mark.line + 1
        return InputError(f"{self._path}:{line}: {' '.join(reason.split())}")

    def error_at(self, key: str, reason: str) -> InputError:
        """The error to raise for the value of `key`."""
        return self.error(reason, self._value(key))

    def has(self, key: str) -> bool:
        """True if the section has `key`."""
        return key in self._items

    def names(self) -> tuple[str, ...]:
        """All keys of the section."""
        return tuple(self._items)

    def section(self, key: str) -> Section:
        """The mapping under `key`."""
        return Section(self._path, self._value(key), f"{self._title}, {key}")

    def text(self, key: str) -> str:
        """The text under `key`, never empty."""
        node = self._value(key)
        if not isinstance(node, yaml.ScalarNode) or not node.value:
            raise self.error(f"'{key}' must be text", node)
        return str(node.value)

    def path_beside(self, key: str) -> Path:
        """The path under `key`, of a file in the folder of this file or below it."""
        name = Path(self.text(key))
        if name.is_absolute() or ".." in name.parts:
            raise self.error_at(key, f"'{key}' must be a file beside this one, without '..'")
        return self._path.parent / name

    def choice(self, key: str, known: Collection[str]) -> str:
        """The text under `key`, one of `known`."""
        word = self.text(key)
        if word not in known:
            reason = f"{self._title}: {key} '{word}' is not one of {', '.join(sorted(known))}"
            raise self.error_at(key, reason)
        return word

    def number(self, key: str, lower: float, upper: float) -> float:
        """The number under `key`, within [lower, upper]."""
        return self._number(key, self._value(key), lower, upper)

    def whole(self, key: str, lower: int, upper: int) -> int:
        """The whole number under `key`, also as 0x7E4, within [lower, upper]."""
        value = self._whole(key, self._value(key))
        if not lower <= value <= upper:
            raise self.error_at(key, f"{self._title}: {key} is outside [{lower:#x}, {upper:#x}]")
        return value

    def whole_numbers(self, key: str) -> tuple[int, ...]:
        """The list of whole numbers under `key`, also as 0x7E4."""
        return tuple(self._whole(key, item) for item in self._list(key))

    def truth(self, key: str) -> bool:
        """The truth value under `key`."""
        return self.choice(key, ("true", "false")) == "true"

    def numbers(self, key: str, lower: float, upper: float) -> tuple[float, ...]:
        """The list of numbers under `key`, each within [lower, upper]."""
        return tuple(self._number(key, item, lower, upper) for item in self._list(key))

    def refuse_unknown(self, known: Collection[str]) -> None:
        """Raise InputError for a key that is not in `known`."""
        for name, (key, _) in self._items.items():
            if name not in known:
                raise self.error(f"unknown key '{name}'{known_names(name, known)}", key)

    def _list(self, key: str) -> list[yaml.Node]:
        node = self._value(key)
        if not isinstance(node, yaml.SequenceNode):
            raise self.error(f"'{key}' must be a list [...] of numbers", node)
        return list(node.value)

    def _whole(self, key: str, node: yaml.Node) -> int:
        try:
            return int(node.value, 0)
        except (TypeError, ValueError):
            reason = f"'{key}' must be a whole number, such as 17 or 0x11"
            raise self.error(reason, node) from None

    def _number(self, key: str, node: yaml.Node, lower: float, upper: float) -> float:
        try:
            value = float(node.value)
        except (TypeError, ValueError):
            raise self.error(f"'{key}' must be a number", node) from None
        if not lower <= value <= upper:
            reason = f"{self._title}: {key} = {value:g} is outside [{lower:g}, {upper:g}]"
            raise self.error(reason, node)
        return value

    def _value(self, key: str) -> yaml.Node:
        if key not in self._items:
            raise self.error(f"{self._title}: '{key}' is missing")
        return self._items[key][1]
