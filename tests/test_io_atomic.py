import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import Call
from skidsteer.errors import DataError
from skidsteer.io import atomic


def content(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_writes_and_replaces_a_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    atomic.write_text(path, "first\n")
    path.chmod(0o640)
    atomic.write_text(path, "zweite µ\n")
    assert path.read_bytes() == "zweite µ\n".encode()
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert os.listdir(tmp_path) == ["calibration.yaml"]


def test_writes_through_a_link_and_into_a_device(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    atomic.write_text(tmp_path / "link", "text")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "text"
    atomic.write_text(os.devnull, "text")
    assert not os.path.isfile(os.devnull)


def test_writes_a_name_that_is_not_utf8_escaped(tmp_path: Path) -> None:
    atomic.write_text(tmp_path / "file", "drive \udcff")
    assert (tmp_path / "file").read_text() == "drive \\udcff"


@pytest.mark.parametrize(
    ("path", "fault"),
    [
        ("missing/file", "there is no folder .*missing; create it first"),
        (".", "it is a folder; name a file in it"),
        ("plain/file", "a file is in the place of a folder"),
        ("x" * 300, "File name too long"),
    ],
)
def test_names_what_is_wrong_with_a_path(tmp_path: Path, path: str, fault: str) -> None:
    (tmp_path / "plain").write_text("")
    with pytest.raises(DataError, match=f"cannot write .*{fault}"):
        atomic.write_text(tmp_path / path, "text")
    assert os.listdir(tmp_path) == ["plain"]


@pytest.mark.parametrize(
    ("check", "path", "fault"),
    [
        (atomic.check_folder, "plain", "cannot be made a folder: .*plain is a file; choose another path"),
        (atomic.check_folder, "plain/folder", "cannot be made a folder: .*plain is a file; choose another path"),
        (atomic.check_file, "missing/file", "there is no folder .*missing; create it first"),
        (atomic.check_file, ".", "it is a folder; name a file in it"),
    ],
)
def test_what_cannot_be_written_is_refused_before_it_is_made(
    tmp_path: Path, check: Callable[[Path], None], path: str, fault: str
) -> None:
    (tmp_path / "plain").write_text("")
    with pytest.raises(DataError, match=fault):
        check(tmp_path / path)
    assert os.listdir(tmp_path) == ["plain"]


@pytest.mark.parametrize(
    "words",
    [
        ("calibrate", "no_drive", "--out", "plain"),
        ("report", "no_calibration", "--out", "missing/report.html"),
        ("odometry", "no_calibration", "no_drive", "--out", os.devnull, "--covariance", "missing/c.csv"),
        ("follow", "--path", "no_path", "--out", "plain/x"),
        ("design", "--area", "no_area", "--out", "plain"),
    ],
)
def test_commands_that_take_long_look_at_their_place_first(tmp_path: Path, words: tuple[str, ...], call: Call) -> None:
    (tmp_path / "plain").write_text("")
    code, out, err = call(*words[:-1], tmp_path / words[-1])
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert "is a file; choose another path" in err or "create it first" in err
    assert os.listdir(tmp_path) == ["plain"]


def test_what_can_be_written_is_not_made_yet(tmp_path: Path) -> None:
    atomic.check_folder(tmp_path / "a" / "b")
    atomic.check_file(tmp_path / "file")
    atomic.check_file("/dev/null")
    assert os.listdir(tmp_path) == []


def test_a_failed_write_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    atomic.write_text(tmp_path / "file", "old")
    monkeypatch.setattr(os, "fsync", _fail(OSError(28, "No space left on device")))
    with pytest.raises(DataError, match="No space left on device"):
        atomic.write_text(tmp_path / "file", "new")
    assert content(tmp_path) == {"file": "old"}


def test_writes_files_that_belong_together(tmp_path: Path) -> None:
    for name in ("a", "stale", "theirs"):
        (tmp_path / name).write_text("old")
    (tmp_path / "a").chmod(0o640)
    atomic.write_files(tmp_path, {"a": "1", "b": "2", "stale": None, "never": None})
    assert content(tmp_path) == {"a": "1", "b": "2", "theirs": "old"}
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


@pytest.mark.parametrize("failing", ["second file", "folder"])
def test_of_files_that_belong_together_all_are_old_or_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    for name in ("a", "stale"):
        (tmp_path / name).write_text("old")
    message = f"cannot write {tmp_path}: No space left on device"
    if failing == "folder":
        (tmp_path / "b").mkdir()
        message = f"cannot write {tmp_path / 'b'}: it is a folder"
    sync, calls = os.fsync, iter([True, False])
    monkeypatch.setattr(
        os, "fsync", lambda f: sync(f) if next(calls) else _fail(OSError(28, "No space left on device"))()
    )
    with pytest.raises(DataError, match=message):
        atomic.write_files(tmp_path, {"a": "new", "b": "new", "stale": None})
    assert {p.name: p.read_text() for p in tmp_path.iterdir() if p.is_file()} == {"a": "old", "stale": "old"}


def test_makes_a_folder_or_says_what_is_in_its_place(tmp_path: Path) -> None:
    atomic.make_folder(tmp_path / "a" / "b")
    atomic.make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="file is a file; choose another path"):
        atomic.make_folder(tmp_path / "file" / "b")


def test_refused_permission_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "replace", _fail(PermissionError(13, "Permission denied")))
    with pytest.raises(DataError, match="permission denied; choose a place you may write to"):
        atomic.write_text(tmp_path / "file", "new")
    assert os.listdir(tmp_path) == []


def test_writes_and_replaces_a_folder(tmp_path: Path) -> None:
    atomic.write_folder(tmp_path / "drive", {"a": "1", "b": "2"})
    atomic.write_folder(tmp_path / "drive", {"c": "3"})
    assert content(tmp_path / "drive") == {"c": "3"}
    assert os.listdir(tmp_path) == ["drive"]


@pytest.mark.parametrize("failing", ["fsync", "second rename"])
def test_a_failed_write_leaves_the_old_folder_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    atomic.write_folder(tmp_path / "drive", {"a": "old"})
    if failing == "fsync":
        monkeypatch.setattr(os, "fsync", _fail(OSError(28, "No space left on device")))
    else:
        rename, calls = os.rename, iter([True, False, True])
        monkeypatch.setattr(os, "rename", lambda a, b: rename(a, b) if next(calls) else _fail(OSError(5, "I/O"))())
    with pytest.raises(DataError, match="cannot write"):
        atomic.write_folder(tmp_path / "drive", {"a": "new", "b": "new"})
    assert content(tmp_path / "drive") == {"a": "old"}
    assert os.listdir(tmp_path) == ["drive"]


def test_does_not_replace_a_file_by_a_folder(tmp_path: Path) -> None:
    (tmp_path / "drive").write_text("precious")
    with pytest.raises(DataError, match="a file is in the place of a folder"):
        atomic.write_folder(tmp_path / "drive", {"a": "1"})
    assert content(tmp_path) == {"drive": "precious"}


def _fail(error: OSError) -> Callable[..., None]:
    def function(*_: object) -> None:
        raise error

    return function
