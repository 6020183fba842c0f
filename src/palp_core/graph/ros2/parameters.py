"""Parameters of the graph's nodes as ROS 2's: each answers under its own name, with what holds now."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import RunningGraph

ASK_S = 5.0
_LISTS = {bool: "bool_array_value", int: "integer_array_value", float: "double_array_value"}


class ParameterServices:
    """ROS 2's six services for the parameters of nodes.

    Args:
        graph: The graph.
    """

    def __init__(self, graph: RunningGraph) -> None:
        self._graph = graph

    def serve(self, name: str, node: Any) -> None:
        """Offer those of a node of the graph at one of ROS 2's."""
        from rcl_interfaces import srv

        offered = {
            "get_parameters": (srv.GetParameters, self._get),
            "get_parameter_types": (srv.GetParameterTypes, self._types),
            "list_parameters": (srv.ListParameters, self._list),
            "describe_parameters": (srv.DescribeParameters, self._describe),
            "set_parameters": (srv.SetParameters, self._set),
            "set_parameters_atomically": (srv.SetParametersAtomically, self._set_all),
        }
        for service, (kind, answer) in offered.items():
            node.create_service(kind, f"~/{service}", _bound(answer, name))

    def _described(self, name: str) -> dict[str, Any]:
        """Return the parameters of a node, described, with their values; none if it does not answer."""
        try:
            found: dict[str, Any] = self._graph.ask(name, "describe_parameters", timeout_s=ASK_S)[
                "parameters"
            ]
        except GraphError:
            return {}
        return found

    def _get(self, name: str, request: Any, response: Any) -> Any:
        known = self._described(name)
        response.values = [parameter_value(known.get(one, {}).get("value")) for one in request.names]
        return response

    def _types(self, name: str, request: Any, response: Any) -> Any:
        known = self._described(name)
        response.types = [parameter_value(known.get(one, {}).get("value")).type for one in request.names]
        return response

    def _list(self, name: str, request: Any, response: Any) -> Any:
        wanted = tuple(request.prefixes)
        names = sorted(self._described(name))
        response.result.names = [n for n in names if not wanted or n.startswith(wanted)]
        return response

    def _describe(self, name: str, request: Any, response: Any) -> Any:
        from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

        known = self._described(name)
        for one in request.names:
            told = known.get(one, {})
            descriptor = ParameterDescriptor(name=one, type=parameter_value(told.get("value")).type)
            descriptor.read_only = bool(told.get("read_only"))
            words = f"{told['description']}; " if told.get("description") else ""
            choices = f"; one of {told['choices']}" if told.get("choices") else ""
            kind = f"{told.get('type', '')} {told.get('unit', '')}".strip()
            descriptor.description = words + kind + choices
            low, high = told.get("minimum"), told.get("maximum")
            if low is not None and high is not None and told.get("type") == "float":
                descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
            elif low is not None and high is not None and told.get("type") == "int":
                descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
            response.descriptors.append(descriptor)
        return response

    def _set(self, name: str, request: Any, response: Any) -> Any:
        response.results = [self._changed(name, [one]) for one in request.parameters]
        return response

    def _set_all(self, name: str, request: Any, response: Any) -> Any:
        response.result = self._changed(name, request.parameters)
        return response

    def _changed(self, name: str, parameters: Any) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        try:
            values = {one.name: plain_value(one.value) for one in parameters}
            self._graph.ask(name, "set_parameters", timeout_s=ASK_S, parameters=values)
        except GraphError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _bound(answer: Callable[[str, Any, Any], Any], name: str) -> Callable[[Any, Any], Any]:
    return lambda request, response: answer(name, request, response)


def parameter_value(value: Any) -> Any:
    """Return a value as ROS 2 has it: what it has no type for, a mapping, is JSON text; None is "not set"."""
    from rcl_interfaces.msg import ParameterType, ParameterValue

    if value is None:
        return ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
    if isinstance(value, bool):
        return ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    if isinstance(value, int):
        return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    if isinstance(value, float):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    if isinstance(value, str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    kinds = {type(item) for item in value} if isinstance(value, list | tuple) else {dict}
    if kinds == {int, float}:
        kinds, value = {float}, [float(item) for item in value]
    if kinds <= {str}:
        return ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=list(value))
    if len(kinds) == 1 and (kind := kinds.pop()) in _LISTS:
        field = _LISTS[kind]
        number = getattr(ParameterType, f"PARAMETER_{field.removesuffix('_value').upper()}")
        return ParameterValue(type=number, **{field: list(value)})
    return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=json.dumps(value))


def plain_value(value: Any) -> Any:
    """Return ROS 2's value as a plain one.

    Raises:
        GraphError: It is not set.
    """
    from rcl_interfaces.msg import ParameterType

    fields: Mapping[int, str] = {
        getattr(ParameterType, f"PARAMETER_{name.upper()}"): f"{name}_value"
        for name in (
            *("bool", "integer", "double", "string", "byte_array"),
            *("bool_array", "integer_array", "double_array", "string_array"),
        )
    }
    if value.type not in fields:
        raise GraphError("a parameter cannot be unset")
    found = getattr(value, fields[value.type])
    return list(found) if value.type >= ParameterType.PARAMETER_BYTE_ARRAY else found
