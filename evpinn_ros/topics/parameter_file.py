"""Checks a parameter file of ROS 2 against the table, without ROS, before anything starts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from evpinn_ros.common.errors import InputError, known_names
from evpinn_ros.common.yaml_section import Section, compose, plain
from evpinn_ros.topics.node_parameters import OF_EVERY_NODE, TABLES, Value, refuse_wrong

Item: TypeAlias = tuple[yaml.Node, yaml.Node]

PARAMETERS_KEY = "ros__parameters"
WILDCARDS = ("*", "**")


def check_parameter_file(path: Path) -> None:
    """Check a file for `--params-file`; InputError with `file:line: reason`."""
    _read(path)


def read_parameter_file(path: Path, node: str) -> dict[str, Value]:
    """The parameters of a node of `TABLES` in a file; InputError if the file is wrong."""
    return _read(path)[node]


def _read(path: Path) -> dict[str, dict[str, Value]]:
    root = compose(path, "parameter file")
    sections = list(_sections(root, root.node, ""))
    if not sections:
        raise root.error(f"no '{PARAMETERS_KEY}' in this file: not a parameter file")
    values_of_node: dict[str, dict[str, Value]] = {node: {} for node in TABLES}
    for name, key, parameters in sections:
        if name not in (*TABLES, *WILDCARDS):
            raise root.error(f"unknown node '{name}'{known_names(name, TABLES)}", key)
        nodes = list(TABLES) if name in WILDCARDS else [name]
        values = _checked(root, nodes, parameters)
        for node in nodes:
            values_of_node[node] |= {
                p.name: values[p.name] for p in TABLES[node] if p.name in values
            }
            try:
                refuse_wrong(TABLES[node], values_of_node[node])
            except InputError as error:
                raise root.error(str(error), parameters) from None
    return values_of_node


def _sections(
    root: Section, node: yaml.Node, name: str
) -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
    """Yields node name, YAML node of the name, and parameters of every section in the file."""
    for key, value in _items(root, node):
        if key.value == PARAMETERS_KEY:
            yield name, node, value
        else:
            # `/ev/estimator:`, `ev: estimator:` and `/**/estimator:` name the same node.
            yield from _sections(root, value, str(key.value).rpartition("/")[2])


def _checked(root: Section, nodes: list[str], section: yaml.Node) -> dict[str, Any]:
    """The values of a section for one node or for all nodes, each value checked by itself."""
    node_of = {parameter.name: node for node in nodes for parameter in TABLES[node]}
    values: dict[str, Any] = {}
    for key, node in _items(root, section):
        name = str(key.value)
        if name.partition(".")[0] in OF_EVERY_NODE:
            continue
        if name not in node_of:
            raise root.error(f"unknown parameter '{name}'{known_names(name, node_of)}", key)
        try:
            values[name] = _value(node)
        except ValueError as error:
            raise root.error(f"{name}: {error}", node) from error
        table = TABLES[node_of[name]]
        if problem := next(p for p in table if p.name == name).problem(values[name]):
            raise root.error(problem, node)
    return values


def _items(root: Section, node: yaml.Node) -> list[Item]:
    if not isinstance(node, yaml.MappingNode):
        raise root.error("expected 'name: value' lines", node)
    return list(node.value)


def _value(node: yaml.Node) -> object:
    """The value as ROS reads it; unlike in YAML 1.1, `1e5` is a number."""
    value = plain(node)
    if isinstance(value, str) and isinstance(node, yaml.ScalarNode) and node.style is None:
        try:
            return float(value)
        except ValueError:
            return value
    return value
