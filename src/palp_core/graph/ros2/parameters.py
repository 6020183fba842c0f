"""Parameters of a node of the graph, served under its name as ROS 2's."""

from __future__ import annotations

import json
from typing import Any

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import RunningGraph

ASK_S = 5.0


class NodeParameters:
    """ROS 2's six services for the parameters of a node."""

    def __init__(self, graph: RunningGraph, name: str, node: Any) -> None:
        from rcl_interfaces import srv

        self._graph, self._name = graph, name
        for service, (kind, answer) in {
            "get_parameters": (srv.GetParameters, self._get),
            "get_parameter_types": (srv.GetParameterTypes, self._get_types),
            "list_parameters": (srv.ListParameters, self._list),
            "describe_parameters": (srv.DescribeParameters, self._describe),
            "set_parameters": (srv.SetParameters, self._set_each),
            "set_parameters_atomically": (srv.SetParametersAtomically, self._set_together),
        }.items():
            node.create_service(kind, f"~/{service}", answer)

    def _described(self) -> dict[str, dict[str, Any]]:
        """Return the parameters with their values; none if the node does not answer."""
        try:
            found: dict[str, dict[str, Any]] = self._graph.ask(
                self._name, "describe_parameters", timeout_s=ASK_S
            )["parameters"]
        except GraphError:
            return {}
        return found

    def _values(self, names: list[str]) -> list[Any]:
        known = self._described()
        return [_ros_value(known.get(name, {}).get("value")) for name in names]

    def _get(self, request: Any, response: Any) -> Any:
        response.values = self._values(request.names)
        return response

    def _get_types(self, request: Any, response: Any) -> Any:
        response.types = [value.type for value in self._values(request.names)]
        return response

    def _list(self, request: Any, response: Any) -> Any:
        prefixes = tuple(request.prefixes) or ("",)
        response.result.names = [name for name in sorted(self._described()) if name.startswith(prefixes)]
        return response

    def _describe(self, request: Any, response: Any) -> Any:
        known = self._described()
        response.descriptors = [_descriptor(name, known.get(name, {})) for name in request.names]
        return response

    def _set_each(self, request: Any, response: Any) -> Any:
        response.results = [self._set([one]) for one in request.parameters]
        return response

    def _set_together(self, request: Any, response: Any) -> Any:
        response.result = self._set(request.parameters)
        return response

    def _set(self, parameters: list[Any]) -> Any:
        from rcl_interfaces.msg import SetParametersResult
        from rclpy.parameter import parameter_value_to_python

        values = {one.name: parameter_value_to_python(one.value) for one in parameters}
        try:
            if None in values.values():
                raise GraphError("a parameter cannot be unset; set a value")
            self._graph.ask(self._name, "set_parameters", timeout_s=ASK_S, parameters=values)
        except GraphError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _descriptor(name: str, described: dict[str, Any]) -> Any:
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

    text, choices = described.get("description"), described.get("choices")
    kind = f"{described.get('type', '')} {described.get('unit', '')}".strip()
    found = ParameterDescriptor(
        name=name,
        type=_ros_value(described.get("value")).type,
        read_only=bool(described.get("read_only")),
        description=(f"{text}; " if text else "") + kind + (f"; one of {choices}" if choices else ""),
    )
    low, high = described.get("minimum"), described.get("maximum")
    if low is not None and high is not None and described.get("type") == "float":
        found.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif low is not None and high is not None and described.get("type") == "int":
        found.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    return found


def _ros_value(value: Any) -> Any:
    """Return a value as ROS 2 has it; what ROS 2 has no type for, a mapping, is JSON text."""
    from rclpy.parameter import Parameter

    if isinstance(value, list) and {type(one) for one in value} == {int, float}:
        value = [float(one) for one in value]
    try:
        return Parameter("value", value=value).get_parameter_value()
    except TypeError:
        return Parameter("value", value=json.dumps(value)).get_parameter_value()
