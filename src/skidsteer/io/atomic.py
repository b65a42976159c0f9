"""Files and folders that appear whole or not at all: written beside their target, then renamed onto it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from skidsteer.errors import DataError


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 file in one step: a reader sees the old content or the new, never a part.

    Symbolic links are followed, an existing file keeps its permissions, a device such as ``/dev/stdout`` is written to.

    Raises:
        DataError: the folder is missing or cannot be written to, or the path is a folder.
    """
    write_bytes(path, _encoded(text))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file in one step, as ``write_text`` does.

    Raises:
        DataError: the folder is missing or cannot be written to, or the path is a folder.
    """
    with _plain_errors(path):
        if _is_device(path):
            Path(path).write_bytes(data)
            return
        _replace({Path(os.path.realpath(path)): data})


def write_files(folder: str | os.PathLike[str], files: Mapping[str, str | None]) -> None:
    """Write UTF-8 files (name -> text) that belong together into a folder that is there; None: no file of that name.

    All are written beside their targets before the first is renamed: what fails earlier, a full disk or a missing
    permission, leaves the old ones. What else the folder holds is left alone.

    Raises:
        DataError: the folder is missing or cannot be written to, or a folder has the name of a file.
    """
    with _plain_errors(folder):
        texts = {Path(os.path.realpath(os.path.join(folder, name))): text for name, text in files.items()}
        _replace({target: None if text is None else _encoded(text) for target, text in texts.items()})


def _replace(contents: Mapping[Path, bytes | None]) -> None:
    for target in contents:
        if target.is_dir():
            raise DataError(f"cannot write {target}: it is a folder; name a file in it, or move it away")
    staged = {target: (_beside(target), data) for target, data in contents.items() if data is not None}
    try:
        for target, (temporary, data) in staged.items():
            _write_through(temporary, data)
            if target.is_file():
                shutil.copymode(target, temporary)
        for target, (temporary, _) in staged.items():
            os.replace(temporary, target)
        for target in contents.keys() - staged.keys():
            target.unlink(missing_ok=True)
    finally:
        for temporary, _ in staged.values():
            temporary.unlink(missing_ok=True)


def write_folder(path: str | os.PathLike[str], files: Mapping[str, str]) -> None:
    """Write a folder of UTF-8 files (name -> text) in one step, in place of any folder of that name.

    What the old folder holds is deleted: whether it may be is for the caller to decide.

    Raises:
        DataError: the parent folder is missing or cannot be written to, or the path is a file.
    """
    with _plain_errors(path):
        target = Path(os.path.realpath(path))
        temporary, old = _beside(target), _beside(target)
        try:
            temporary.mkdir()
            for name, text in files.items():
                _write_through(temporary / name, _encoded(text))
            if target.is_dir():
                os.rename(target, old)
            os.rename(temporary, target)
        finally:
            if old.exists() and not target.exists():
                os.rename(old, target)
            shutil.rmtree(temporary, ignore_errors=True)
            shutil.rmtree(old, ignore_errors=True)


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder that can be written to, with those it lies in, unless it is there.

    Raises:
        DataError: as ``check_folder``, or it cannot be made.
    """
    check_folder(path)
    with _plain_errors(path):
        Path(path).mkdir(parents=True, exist_ok=True)


def check_folder(path: str | os.PathLike[str]) -> None:
    """Refuse a folder that can neither be written to nor made; for before a long calculation, as it makes nothing.

    Raises:
        DataError: a file is in its place, or permission is missing.
    """
    there = Path(os.path.realpath(path))
    while not os.path.exists(there):
        there = there.parent
    if not there.is_dir():
        raise DataError(f"{path}: cannot be made a folder: {there} is a file; choose another path")
    _check_permission(path, there)


def check_file(path: str | os.PathLike[str]) -> None:
    """Refuse a file that cannot be written, as ``check_folder`` does.

    Raises:
        DataError: its folder is missing, the path is a folder, or permission is missing.
    """
    parent = os.path.dirname(os.path.realpath(path))
    if os.path.isdir(path):
        raise DataError(f"cannot write {path}: it is a folder; name a file in it")
    if not os.path.isdir(parent):
        raise DataError(f"cannot write {path}: there is no folder {parent}; create it first")
    if not _is_device(path):
        _check_permission(path, parent)


def _check_permission(path: str | os.PathLike[str], folder: str | os.PathLike[str]) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise DataError(f"cannot write {path}: permission denied in {folder}; choose a place you may write to")


def _beside(target: Path) -> Path:
    return target.parent / f".skidsteer-{uuid4().hex}.tmp"


def _is_device(path: str | os.PathLike[str]) -> bool:
    return os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path))


def _encoded(text: str) -> bytes:
    # A file name that is not UTF-8 reaches us as lone surrogates: shown escaped, as no encoder takes them.
    return text.encode("utf-8", errors="backslashreplace")


def _write_through(path: Path, data: bytes) -> None:
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def _plain_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except IsADirectoryError as error:
        raise DataError(f"cannot write {path}: it is a folder; name a file in it") from error
    except NotADirectoryError as error:
        raise DataError(f"cannot write {path}: a file is in the place of a folder; choose another path") from error
    except PermissionError as error:
        raise DataError(f"cannot write {path}: permission denied; choose a place you may write to") from error
    except OSError as error:
        parent = os.path.dirname(os.path.realpath(path))
        if not os.path.exists(parent):
            raise DataError(f"cannot write {path}: there is no folder {parent}; create it first") from error
        raise DataError(f"cannot write {path}: {error.strerror or error}") from error
