"""What can be wrong with a user's data or request; each message names the fact and the cure, on one line."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")


class SkidSteerError(Exception):
    """Bad data or an impossible request. The command line prints it as one line and exits with 1."""


class DataError(SkidSteerError):
    """A file or a log that cannot be used: what, where, and what to do."""


class RequestError(SkidSteerError):
    """A request that the given data or model cannot serve."""


def printable(text: str) -> str:
    """Text from a file that may be shown: line breaks, control, escape and direction marks become question marks."""
    return "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else "?" for c in text)


def named(name: str, what: str, known: Mapping[str, T], otherwise: str = "") -> T:
    """What is known by that name.

    Raises:
        RequestError: no such ``what``; the message lists those there are, and ``otherwise`` behind them.
    """
    if name not in known:
        raise RequestError(f"no {what} '{name}'; there are: {', '.join(known)}{otherwise}")
    return known[name]
