"""What all reproductions share: verdicts, the places of a paper, the document, the command."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import Call
from skidsteer.documents import reproduction_document
from skidsteer.errors import RequestError
from skidsteer.io.folder import write_folder
from skidsteer.reproduce import papers
from skidsteer.reproduce.figure import Curve, Figure, draw
from skidsteer.reproduce.markdown import document
from skidsteer.reproduce.papers import PAPERS, write
from skidsteer.reproduce.rows import VERDICTS, Place, Reproduction, Row, Table, compared, places_named, stands_in, tally
from skidsteer.samples import sample

NAN = float("nan")


def picture(name: str = "figure-4") -> Figure:
    x = np.array([1.0, 2.0])
    return Figure(name, "Title", "t [s]", "y, m", (Curve("a", x, 2.0 * x), Curve("b, c", x, x, x - 0.5, x + 0.25)))


def done() -> Reproduction:
    rows = (
        Row("a | b, Table 3", 2.0, 2.5, "cannot be reproduced", "why"),
        Row("c, Figs. 4, 5", NAN, 1.0, "reproduced"),
        stands_in("d, Table 3", 1.0, 1.0, "simulated"),
    )
    places = (Place("Table 3", "errors"), Place("Fig. 4", "curves"), Place("Fig. 6", "a robot", "a photograph"))
    side = Table("Side by side", ("model", "simulated", "real"), (("ours", (0.1, NAN)),), "a note")
    return Reproduction(rows, (picture(),), (side,), places, ("a misprint",))


def test_the_verdicts_are_those_four() -> None:
    assert VERDICTS == (
        "reproduced",
        "corrected",
        "cannot be reproduced",
        "not possible without the original data",
    )
    with pytest.raises(ValueError, match="verdict must be one of reproduced, corrected"):
        Row("x", 1.0, 1.0, "fine")  # type: ignore[arg-type]


@pytest.mark.parametrize("verdict", VERDICTS[1:])
def test_all_but_the_good_verdict_give_a_reason(verdict: str) -> None:
    with pytest.raises(ValueError, match=f"'x' is {verdict}: give the reason"):
        Row("x", 1.0, 2.0, verdict)  # type: ignore[arg-type]


def test_compared_tells_what_is_off() -> None:
    assert compared("x", 1.0, 1.05, 0.05).verdict == "reproduced"
    off = compared("x", 1.0, 1.06, 0.05)
    assert (off.verdict, off.reason) == ("cannot be reproduced", "off by more than 0.05")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("x_ICR, left turns, Table 3", {"Table 3"}),
        ("errors, Figs. 12, 13 and 14 beside Table III", {"Fig. 12", "Fig. 13", "Fig. 14", "Table III"}),
        ("chi of Tables 1 and 2 at lambda = 3, 4", {"Table 1", "Table 2"}),
        ("speed at k = 80, Eq. (5), section V", set()),
    ],
)
def test_places_named(text: str, named: set[str]) -> None:
    assert places_named(text) == named


def test_rows_and_figures_find_their_places() -> None:
    table, curves, photo = done().places
    assert [row.what for row in done().rows_of(table)] == ["a | b, Table 3", "d, Table 3"]
    assert [row.what for row in done().rows_of(curves)] == ["c, Figs. 4, 5"]
    assert [f.name for f in done().figures_of(curves)] == ["figure-4"]
    assert done().figures_of(photo) == done().figures_of(table) == ()
    parts = Reproduction((), (picture("figure-12a"), picture("figure-12-real"), picture("figure-1")))
    assert len(parts.figures_of(Place("Fig. 12", ""))) == 2


def test_the_document_holds_every_row() -> None:
    text = document({"p": done()}, {"p": "A paper"})
    assert "| p](#p) | 1 | 0 | 1 | 1 |" in text.replace("| [p", "| p")
    assert r"| a \| b, Table 3 | 2 | 2.5 | 0.5 | cannot be reproduced | why |" in text
    assert "| c, Figs. 4, 5 | - | 1 | - | reproduced |  |" in text
    assert "| Table 3 | errors | 1 cannot be reproduced; 1 not possible without the original data |" in text
    assert "| Fig. 4 | curves | 1 reproduced; `figure-4` |" in text
    assert "| Fig. 6 | a robot | a photograph |" in text
    assert "| ours | 0.1 | - |" in text
    assert "- a misprint" in text
    assert "![Title](figures/p-figure-4.svg)" in text


def test_a_drawing_is_the_same_every_time(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw(picture(), tmp_path / "a.png")
    draw(picture(), tmp_path / "a.svg")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    text = (tmp_path / "a.svg").read_text()
    assert "<svg" in text
    draw(picture(), tmp_path / "a.svg")
    assert (tmp_path / "a.svg").read_text() == text


def test_all_is_written_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setitem(PAPERS, "p", papers.Paper("A paper", "none"))
    files = write({"p": done()}, tmp_path)
    assert {f.relative_to(tmp_path).as_posix() for f in files} == {"reproduction.md", "figures/p-figure-4.svg"}
    assert all(f.stat().st_size for f in files)
    found = reproduction_document("p", done())
    assert found["figures"][0]["curves"][1]["low"] == [0.5, 1.5]
    assert "low" not in found["figures"][0]["curves"][0]
    assert found["verdicts"] == tally(done().rows)
    assert found["places"][0]["rows"] == ["a | b, Table 3", "d, Table 3"]
    assert found["tables"][0]["lines"][0][0] == "ours"


def test_the_command_prints_and_writes(call: Call, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    code, out, err = call("reproduce", "giannoccaro2015", "--json", "--out", tmp_path / "new")
    assert code == 0, err
    told = json.loads(out)
    assert told["paper"] == "giannoccaro2015"
    row = told["rows"][0]
    assert row["difference"] == pytest.approx(row["ours"] - row["paper"])
    text = (tmp_path / "new" / "reproduction.md").read_text()
    assert all(row["what"] in text for row in told["rows"])
    code, out, err = call("reproduce", "giannoccaro2015")
    assert code == 0
    assert "corrected" in out
    assert re.search(r"\d+ reproduced; \d+ corrected; \d+ cannot be reproduced", out)


def test_all_papers_at_once(call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    few = {name: PAPERS[name] for name in ("mandow2007", "huskic2017")}
    asked = []
    monkeypatch.setattr(papers, "PAPERS", few)
    monkeypatch.setenv(papers.DATA, str(tmp_path))
    monkeypatch.setattr(papers, "reproduce", lambda name, drive: asked.append((name, drive)) or done())
    code, out, err = call("reproduce", "all", "--json")
    assert code == 0, err
    assert list(json.loads(out)["papers"]) == list(few)
    code, out, _ = call("reproduce", "all", "--drive", "sample:p3at-mandow")
    assert out.count("1 reproduced; 1 cannot be reproduced; 1 not possible without the original data") == 2
    assert [(name, drive and drive.name) for name, drive in asked] == [
        ("mandow2007", None),
        ("huskic2017", None),
        ("mandow2007", "p3at-mandow"),
        ("huskic2017", "p3at-mandow"),
    ]


def test_the_real_drive_is_found_where_the_variable_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(papers.DATA, str(tmp_path))
    assert papers.real_drive(["mandow2007"]) is None
    write_folder(sample("p3at-mandow").between(0.0, 5.0), tmp_path / papers.REAL)
    assert papers.real_drive(["wang2015"]) is None
    found = papers.real_drive(["wang2015", "mandow2007"])
    assert found is not None
    assert found.name == papers.REAL
    with pytest.raises(RequestError, match="--drive is of no use here: a drive is taken by mandow2007"):
        papers.real_drive(["wang2015"], "sample:p3at-mandow")


def test_where_nothing_can_be_written_nothing_is_calculated(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("x")
    monkeypatch.setattr(papers, "reproduce", lambda *_: pytest.fail("calculated"))
    code, out, err = call("reproduce", "all", "--out", tmp_path / "file" / "new")
    assert (code, out) == (1, "")
    assert "cannot be made a folder" in err
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, out, err = call("reproduce", "all", "--out", tmp_path / "new")
    assert (code, out) == (1, "")
    assert err.strip().endswith("drawing needs matplotlib: pip install 'skidsteer[figures]'")


def test_differences_in_the_last_bits_are_none() -> None:
    assert Row("x", 547.0, 546.9999999999999, "reproduced").difference == 0.0
    assert Row("x", 1.0, 1.0 + 1e-9, "reproduced").difference == pytest.approx(1e-9)


def test_an_unknown_paper_is_told_with_those_there_are(call: Call) -> None:
    code, _, err = call("reproduce", "nobody2020")
    assert code == 1
    assert err.strip() == f"skidsteer: no paper 'nobody2020'; there are: {', '.join(PAPERS)}, or all"
    with pytest.raises(RequestError, match="or all"):
        papers.reproduce("nobody2020")
    assert papers.asked("all") == tuple(PAPERS)
