"""rclpy's messages from dictionaries of their fields; their packages are imported when they are used."""

from __future__ import annotations

import importlib
from typing import Any


def message_type(kind: str) -> Any:
    """The class of a type "package/msg/Name" or "package/Name"; raises ImportError without the package."""
    package, _, name = kind.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name.removeprefix("msg/"))


def filled(message: Any, values: dict[str, Any]) -> Any:
    """The message, its fields set from a dictionary; those not in it stay as they are."""
    for name, value in values.items():
        if isinstance(value, dict):
            filled(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            # "sequence<geometry_msgs/Point>" or "sequence<geometry_msgs/Point, 3>".
            inner = message.get_fields_and_field_types()[name].partition("<")[2].rstrip(">").partition(",")[0]
            one = message_type(inner)
            setattr(message, name, [filled(one(), item) for item in value])
        else:
            setattr(message, name, value)
    return message
