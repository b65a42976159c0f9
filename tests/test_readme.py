"""What the README tells a newcomer to type works."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from conftest import Run
from skidsteer.io.folder import write_folder
from skidsteer.samples import sample

README = Path(__file__).parents[1] / "README.md"


@pytest.fixture(scope="module")
def text() -> str:
    if not README.is_file():
        pytest.skip("no README beside an installed package")
    return README.read_text(encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files that the README speaks of."""
    drive = sample("p3at-lab").between(0.0, 60.0)
    write_folder(drive, tmp_path / "other_drive")
    for name in ("wheels.csv", "pose.csv"):
        shutil.copy(tmp_path / "other_drive" / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_command_of_the_readme_runs(text: str, folder: Path, run: Run) -> None:
    lines = [line.split("#")[0].strip() for line in re.findall(r"^    (skidsteer .*)$", text, re.MULTILINE)]
    assert len(lines) >= 5
    for line in lines:
        words = ["sample:p3at-lab" if word.endswith(".mcap") else word for word in line.split()[1:]]
        result = run(*words, cwd=folder)
        assert result.returncode == 0, (line, result.stderr)
    assert (folder / "result" / "calibration.yaml").exists()


def test_the_python_of_the_readme_runs(text: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    assert "icr_y_left: 0.25" in capsys.readouterr().out
    assert (folder / "calibration.yaml").exists()
