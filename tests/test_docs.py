"""What the documents tell a reader to type works, and what they say it prints is what it prints."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.console import Console

from conftest import DATA, Call
from skidsteer import console
from skidsteer.io.folder import write_folder
from skidsteer.models import MODELS
from skidsteer.samples import sample

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
DOCUMENTS = sorted(p.relative_to(ROOT).as_posix() for p in PAGES if p.is_file())  # none beside an installed package
CLOSE = 0.02  # share by which a number may differ from machine to machine


@dataclass(frozen=True)
class Block:
    """A command, and lines of what it prints; dots stand for lines left out."""

    command: str
    printed: tuple[str, ...]


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(text: str) -> Iterator[Block]:
    """Every indented line that begins with the command, and the indented lines below it."""
    command, printed = "", list[str]()
    for line in [*text.splitlines(), ""]:
        body = line[4:] if line.startswith("    ") else None
        if command and (body is None or body.startswith("skidsteer ")):
            yield Block(command, tuple(printed))
            command, printed = "", []
        if body is not None and body.startswith("skidsteer "):
            command = body.split("  #")[0].split(" # ")[0].strip()
        elif command and body is not None:
            printed.append(body)


def tokens(line: str) -> list[str]:
    return re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?|[^\s\d]+", line)


def alike(told: str, found: str) -> bool:
    """The same words, and nearly the same numbers: within a unit of the last digit, or ``CLOSE``."""
    a, b = tokens(told), tokens(found)
    return len(a) == len(b) and all(map(_alike, a, b))


def _alike(told: str, found: str) -> bool:
    try:
        value, other = float(told), float(found)
    except ValueError:
        return told == found
    digit = 10.0 ** -len(told.partition(".")[2].partition("e")[0])
    return abs(value - other) <= max(1.5 * digit, CLOSE * abs(value))


def missing(block: Block, out: str) -> str | None:
    """The first line told that was not printed below the one before; None where all were."""
    lines = iter(out.splitlines())
    for told in block.printed:
        if told.strip() != "..." and not any(alike(told, line) for line in lines):
            return told
    return None


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files that the documents speak of; a terminal 100 wide."""
    drive = sample("p3at-mandow").between(0.0, 60.0)
    write_folder(drive, tmp_path / "other_drive")
    for name in ("wheels.csv", "pose.csv"):
        shutil.copy(tmp_path / "other_drive" / name, tmp_path / name)
    if (DATA / "warthog-asphalt").is_dir():
        (tmp_path / "warthog-asphalt").symlink_to(DATA / "warthog-asphalt")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(console, "OUT", Console(highlight=False, width=100))
    return tmp_path


def code_of(name: str) -> list[str]:
    """Its blocks of Python."""
    return re.findall(r"```python\n(.*?)```", text_of(name), re.DOTALL)


@pytest.mark.parametrize("name", [name for name in DOCUMENTS if any(blocks((ROOT / name).read_text("utf-8")))])
def test_every_command_runs_and_prints_what_is_told(name: str, folder: Path, call: Call) -> None:
    for block in blocks(text_of(name)):
        if "warthog-asphalt" in block.command and not (folder / "warthog-asphalt").exists():
            continue
        words = ["other_drive" if word.endswith(".mcap") else word for word in block.command.split()[1:]]
        code, out, err = call(*words)
        assert code == 0, (block.command, err)
        assert missing(block, out) is None, (block.command, missing(block, out), out)
    if name == "README.md":
        promised = {"calibration.yaml", "report.html", "ros2_control.yaml", "ekf.yaml", "model.json"}
        assert promised <= {p.name for p in (folder / "result").iterdir()}


@pytest.mark.parametrize("name", [name for name in DOCUMENTS if code_of(name)])
def test_python_runs(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, space = dict(MODELS), {"__name__": name}
    try:
        for i, part in enumerate(code_of(name)):
            exec(compile(part, f"{name}:{i}", "exec", dont_inherit=True), space)
    finally:
        MODELS.clear()
        MODELS.update(before)
    if name == "README.md":
        assert "icr_y_left: 0.27" in capsys.readouterr().out
        assert (folder / "calibration.yaml").exists()


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_lead_somewhere(name: str) -> None:
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text_of(name)):
        assert (ROOT / name).parent.joinpath(target).exists(), target


@pytest.mark.parametrize("name", DOCUMENTS)
def test_make_targets_are_there(name: str) -> None:
    made = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for target in re.findall(r"^    make (\w+)|`make (\w+)`", text_of(name), re.MULTILINE):
        assert (target[0] or target[1]) in made


def test_a_line_that_was_not_printed_is_noticed() -> None:
    block = Block("skidsteer", ("icr_y_left 0.290 m", "...", "After: 1.2 deg."))
    assert missing(block, "icr_y_left   0.2905  m\nx\nAfter: 1.22 deg.") is None
    assert missing(block, "icr_y_left   0.310  m\nAfter: 1.2 deg.") == "icr_y_left 0.290 m"
    assert missing(block, "After: 1.2 deg.\nicr_y_left 0.290 m") == "After: 1.2 deg."
    assert missing(block, "icr_y_left 0.290 mm\nAfter: 1.2 deg.") == "icr_y_left 0.290 m"
