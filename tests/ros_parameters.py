"""How ROS 2 types the parameters of a file, in our own words: rcl_yaml_param_parser, over the same libyaml.

ros2/rcl, rcl_yaml_param_parser/src/parse.c: what is not quoted is a bool where it is one of 22 words, else an integer
where the C function strtol with base 0 takes all of it, else a double where strtod does, else a text. Lists hold one
type; aliases are refused. A parameter of another type than its node declares stops the node.
"""

from __future__ import annotations

import re
from itertools import takewhile
from typing import Any

import yaml

_YES = ("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON")
_NO = ("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF")
_INT = re.compile(r"[-+]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9]\d*)")
_DECIMAL = r"((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)"
_HEX = r"(0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP][-+]?\d+)?)"
_DOUBLE = re.compile(rf"[-+]?({_DECIMAL}|{_HEX}|(?i:inf|infinity|nan|nan\(\w*\)))|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


def type_of(event: yaml.ScalarEvent) -> type:
    if event.style in ("'", '"'):
        return str
    if event.value in (*_YES, *_NO):
        return bool
    if _INT.fullmatch(event.value):
        return int
    return float if _DOUBLE.fullmatch(event.value) else str


def parameter_types(text: str) -> dict[str, dict[str, Any]]:
    """Types by node and parameter, that of a list as [type]; nested names are joined by dots."""
    nodes: dict[str, dict[str, Any]] = {}
    events = iter(yaml.parse(text, Loader=yaml.CSafeLoader))
    assert [type(next(events)) for _ in range(3)] == [
        yaml.StreamStartEvent,
        yaml.DocumentStartEvent,
        yaml.MappingStartEvent,
    ]
    for key in takewhile(_is_scalar, events):
        assert isinstance(next(events), yaml.MappingStartEvent)
        inner = next(events)
        assert inner.value == "ros__parameters"
        assert isinstance(next(events), yaml.MappingStartEvent)
        nodes[key.value] = _mapping(events, "")
        assert isinstance(next(events), yaml.MappingEndEvent)
    assert [type(event) for event in events] == [yaml.DocumentEndEvent, yaml.StreamEndEvent]
    return nodes


def _is_scalar(event: Any) -> bool:
    return isinstance(event, yaml.ScalarEvent)


def _mapping(events: Any, prefix: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key in events:
        if isinstance(key, yaml.MappingEndEvent):
            return found
        value = next(events)
        assert not isinstance(value, yaml.AliasEvent)
        if isinstance(value, yaml.MappingStartEvent):
            found |= _mapping(events, f"{prefix}{key.value}.")
        elif isinstance(value, yaml.SequenceStartEvent):
            kinds = {type_of(item) for item in takewhile(_is_scalar, events)}
            assert len(kinds) == 1, f"{prefix}{key.value} mixes {kinds}"
            found[prefix + key.value] = [*kinds]
        else:
            found[prefix + key.value] = type_of(value)
    raise AssertionError("the mapping has no end")
