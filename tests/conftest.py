"""Where the real drives are, and how tests run the command line."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from skidsteer import cli

DATA = Path(os.environ.get("SKIDSTEER_DATA", Path(__file__).parents[2] / "shared" / "data"))
POSE_DRIVES = (
    "warthog-asphalt",
    "warthog-grass-a",
    "warthog-grass-b",
    "warthog-asphalt-windows",
    "warthog-gravel-windows",
    "warthog-sand-windows",
    "husky-windows",
    "husky-mocap",
)

Run = Callable[..., "subprocess.CompletedProcess[str]"]
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="session")
def real() -> Callable[[str], Path]:
    """Path of a real drive by name; the test is skipped where the drives are not there."""

    def path(name: str) -> Path:
        if not (DATA / name).is_dir():
            pytest.skip("the real drives are not here")
        return DATA / name

    return path


@pytest.fixture(scope="session")
def run() -> Run:
    """Run the installed command in a process of its own, as a user does."""

    def call(*args: object, **options: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", "from skidsteer.cli import main; main()", *map(str, args)]
        return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, **options)  # type: ignore[call-overload,no-any-return]

    return call


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Run the command line in this process; its exit code, standard output and error."""

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["skidsteer", *map(str, words)])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capsys.readouterr()
        return code, out, err

    return run
