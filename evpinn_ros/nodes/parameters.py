"""Declares the parameters of a node from their table, and refuses wrong values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from evpinn_ros.common.errors import InputError, near_names
from evpinn_ros.topics.node_parameters import OF_EVERY_NODE, TABLES, Parameter, Value, refuse_wrong


def declare(node: Node, table: tuple[Parameter, ...]) -> dict[str, Any]:
    """Declare a table's parameters; returns their values by name, updated by later changes.

    A managed node accepts any value until it is configured; `configure` then refuses wrong ones.
    """
    given = node._parameter_overrides.get("managed")
    managed = given is not None and given.value is True
    entries = [
        (parameter.name, parameter.default, _descriptor(parameter, managed)) for parameter in table
    ]
    try:
        declared = node.declare_parameters("", entries)
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise InputError(str(error)) from error
    values = {parameter.name: parameter.value for parameter in declared}
    if not managed:
        refuse_wrong(table, values)
    fixed = {parameter.name for parameter in table if parameter.read_only} if managed else set()
    node.add_on_set_parameters_callback(_refuser(node, table, values, fixed))

    def follow(changed: list[RosParameter]) -> None:
        values.update(
            {parameter.name: parameter.value for parameter in changed if parameter.name in values}
        )

    node.add_post_set_parameters_callback(follow)
    return values


def unknown_parameters(node: Node, table: tuple[Parameter, ...]) -> list[str]:
    """A line for each given parameter that no node of this package has; rclpy ignores it."""
    all_names = {parameter.name for table in TABLES.values() for parameter in table}
    names = [parameter.name for parameter in table]
    return [
        f"unknown parameter '{given}'{near_names(given, names)}"
        for given in node._parameter_overrides
        if given not in all_names and given.partition(".")[0] not in OF_EVERY_NODE
    ]


def overrides(values: Mapping[str, Value]) -> list[RosParameter]:
    """Values as parameters for a node: `EnergyNode(parameter_overrides=overrides({...}))`."""
    return [RosParameter(name, value=value) for name, value in values.items()]


def _refuser(
    node: Node, table: tuple[Parameter, ...], values: Mapping[str, Any], fixed: set[str]
) -> Callable[[list[RosParameter]], Any]:
    def refuse(changed: list[RosParameter]) -> Any:
        new = {
            parameter.name: parameter.value for parameter in changed if parameter.name in values
        }
        if not new:  # rclpy's own, four for each topic; a check reads the vehicle file, 5 ms
            return SetParametersResult(successful=True)
        if "managed" in new:
            return SetParametersResult(successful=False, reason="managed: fixed at the start")
        if fixed and not node.configured:
            return SetParametersResult(successful=True)
        try:
            if wrong := sorted(fixed.intersection(new)):
                raise InputError(f"{wrong[0]}: fixed until the node is cleaned up")
            refuse_wrong(table, {**values, **new})
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    return refuse


def _descriptor(parameter: Parameter, managed: bool) -> ParameterDescriptor:
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    choices = ", ".join(parameter.choices)
    descriptor = ParameterDescriptor(
        description=parameter.description + unit,
        read_only=parameter.read_only and not managed,
        dynamic_typing=managed,
        additional_constraints=f"one of {choices}" if choices else "",
    )
    lower, upper = parameter.lower, parameter.upper
    if math.isfinite(lower) and not managed:
        if isinstance(parameter.default, float):
            ends = FloatingPointRange(from_value=lower, to_value=upper)
            descriptor.floating_point_range = [ends]
        else:
            whole = IntegerRange(from_value=int(lower), to_value=int(upper), step=1)
            descriptor.integer_range = [whole]
    return descriptor
