"""Files of unknown content as bytes and text, and short pieces of them for a message of one line."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable

from skidsteer.errors import DataError

Path = str | os.PathLike[str]


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """The content of a regular file.

    Raises:
        DataError: no such file, a folder or device, no permission, or larger than ``limit`` bytes.
    """
    try:
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode):
            raise DataError(f"{path}: is a {'folder' if stat.S_ISDIR(mode) else 'device or pipe'}, not a file")
        with open(path, "rb") as file:
            data = file.read() if limit is None else file.read(limit + 1)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file") from error
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {reason(error)}") from error
    if limit is not None and len(data) > limit:
        raise DataError(f"{path}: is larger than {limit} bytes, too large for what it should be; is it another file?")
    return data


def decode(path: Path, data: bytes) -> str:
    """The text of UTF-8 bytes, without a byte order mark.

    Raises:
        DataError: binary data, or text in another encoding.
    """
    if b"\0" in data:
        raise DataError(f"{path}: is binary (or UTF-16), not text in UTF-8; export it as such")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise DataError(f"{path}: line {line} is not UTF-8 text; save the file as UTF-8") from error


def names_in(folder: Path) -> set[str]:
    """Names of what is in a folder.

    Raises:
        DataError: no such folder, a file, or no permission.
    """
    try:
        return set(os.listdir(folder))
    except FileNotFoundError as error:
        raise DataError(f"{folder}: no such folder") from error
    except NotADirectoryError as error:
        raise DataError(f"{folder}: is a file, not a folder") from error
    except (OSError, ValueError) as error:
        raise DataError(f"{folder}: cannot be read: {reason(error)}") from error


def reason(error: Exception) -> str:
    """What the operating system says, without number and path."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def short(text: str) -> str:
    """The text in quotes on one line, cut at 30 characters."""
    return repr(text if len(text) <= 30 else text[:27] + "...")


def listed(names: Iterable[str]) -> str:
    """The first dozen of some names, or ``nothing``."""
    quoted = [name if name.isprintable() and len(name) <= 30 else short(name) for name in names]
    more = f" and {len(quoted) - 12} more" if len(quoted) > 12 else ""
    return (", ".join(quoted[:12]) or "nothing") + more
