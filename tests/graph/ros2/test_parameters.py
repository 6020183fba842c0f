"""What a parameter becomes in ROS 2."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.graph.ros2.parameters import _ros_value
from tests.graph.ros2.own_domain import NEEDS_RCLPY

pytestmark = NEEDS_RCLPY


@pytest.mark.parametrize(
    ("value", "field", "expected"),
    [
        (None, "type", 0),
        (True, "bool_value", True),
        (3, "integer_value", 3),
        (2.5, "double_value", 2.5),
        ("a", "string_value", "a"),
        ([1, 2.5], "double_array_value", [1.0, 2.5]),
        ([1, 2], "integer_array_value", [1, 2]),
        (["a"], "string_array_value", ["a"]),
        ({"a": 1}, "string_value", '{"a": 1}'),
        ([{"a": 1}], "string_value", '[{"a": 1}]'),
    ],
)
def test_a_value_has_ros_2s_type_or_is_json(value: Any, field: str, expected: Any) -> None:
    found = getattr(_ros_value(value), field)
    assert (list(found) if isinstance(expected, list) else found) == expected
