"""YAML with comments, in which no name can break out of its place."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from typing import Any

import yaml

from skidsteer.errors import printable

WIDTH = 100
# What ROS 2's own parser takes for a bool or a number though YAML does not: y, 1e5, 017, inf.
_NO_TEXT = re.compile(r"[yn]|[-+]?(\.?\d.*|inf(inity)?|nan.*)", re.IGNORECASE)


class _Dumper(yaml.SafeDumper):
    """Quotes every text that somebody could read as something else."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="'" if _NO_TEXT.fullmatch(text) else None)


_Dumper.add_representer(str, _text)


def comment(*paragraphs: str) -> str:
    """Paragraphs as lines of comment; whatever is no printable character becomes a question mark.

    A paragraph that begins with a space is kept as it is, as a row of a table or a command to copy.
    """
    lines: list[str] = []
    for paragraph in map(printable, paragraphs):
        is_row = not paragraph or paragraph.startswith(" ")
        lines += [paragraph] if is_row else textwrap.wrap(paragraph, WIDTH - 2, break_long_words=False)
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


def mapping(content: dict[str, Any]) -> str:
    """A mapping as YAML, in its own order, with lists on one line."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=WIDTH)


def rounded(values: Iterable[float], digits: int = 6) -> list[float]:
    """Numbers to some digits: ROS takes ``1`` for an integer and refuses it, ``1.0`` is what these are written as."""
    return [float(f"{value:.{digits}g}") for value in values]
