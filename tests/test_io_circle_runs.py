import re
from pathlib import Path

import pytest

from skidsteer.errors import DataError
from skidsteer.io.circle_runs import read_circle_runs
from skidsteer.models.slip_ratio import CircleRun


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "runs.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_radii_surfaces_and_names(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "surface; v_right; v_left; radius; direction; speed; name; lambda\n"
        "wet grass; 0.6; 0.2; 0.8; left; 0.35; a; 2\n\n"
        "; 0.2; 0.6; 1.1; RIGHT; ; ;\n",
    )
    assert read_circle_runs(path) == (
        CircleRun(0.2, 0.6, 0.8, "wet grass", 0.35, name="a"),
        CircleRun(0.6, 0.2, 1.1),
    )


def test_numbers_alone(tmp_path: Path) -> None:
    assert read_circle_runs(write(tmp_path, "v_left,v_right,radius\n0.2,0.6,0.8\n")) == (CircleRun(0.2, 0.6, 0.8),)


def test_chord_and_sagitta(tmp_path: Path) -> None:
    runs = read_circle_runs(write(tmp_path, "v_left,v_right,chord,sagitta,surface\n0.2,0.6,1.0,0.25,tiles\n"))
    assert runs == (CircleRun(0.2, 0.6, 2.0, "tiles"),)


def test_each_row_by_what_was_measured(tmp_path: Path) -> None:
    runs = read_circle_runs(
        write(tmp_path, "v_left,v_right,radius,chord,sagitta\n0.2,0.6,0.8,,\n0.2,0.6,,1,0.25\n0.2,0.6,2.02,1,0.25\n")
    )
    assert [run.radius for run in runs] == [0.8, 2.0, 2.02]


HEAD = "v_left,v_right,radius\n"
ALL = "v_left,v_right,radius,chord,sagitta\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "0.2,0.6,1\n0.4,0.4,1\n", "line 3: both sides run at 0.4 m/s: a straight run has no radius"),
        (HEAD + "0,0,1\n", "line 2: both sides are at rest"),
        (HEAD + "-0.3,0.3,1\n", "line 2: the sides run against each other"),
        (HEAD + "0.2,0.6,-1\n", "line 2: the radius must be a positive length in m, got -1"),
        (HEAD + "0.2,0.6,nan\n", "line 2: the radius must be a positive length in m, got nan"),
        (HEAD + "0.2,0.6,\n", "line 2: has no radius, and not both chord and sagitta"),
        (HEAD + "0.2,0.6,wide\n", "line 2, column 'radius': 'wide' is not a number"),
        (HEAD + "0.2,0.6,1_0\n", "line 2, column 'radius': '1_0' is not a number"),
        (HEAD + "0.2,,1\n", "line 2, column 'v_right' is empty"),
        (HEAD + "0.2,inf,1\n", "line 2, column 'v_right' is inf"),
        (HEAD + "0.2,0.6\n", "line 2 has 2 cells, the header 3"),
        (HEAD, "has a header and no rows"),
        ("", "is empty"),
        ("v_left,v_right\n0.2,0.6\n", "no column 'radius', and not both 'chord' and 'sagitta'; there are:"),
        ("v_left,v_right,chord\n0.2,0.6,1\n", "no column 'radius', and not both 'chord' and 'sagitta'"),
        ("v_left,radius\n0.2,1\n", "no column 'v_right'"),
        ("v_left,v_right,radius,radius\n0.2,0.6,1,1\n", "two columns are named 'radius'"),
        (ALL + "0.2,0.6,,1,-0.1\n", "line 2: chord and sagitta must be positive lengths in m, got 1 and -0.1"),
        (ALL + "0.2,0.6,,0.5,1\n", "line 2: chord 0.5 m and sagitta 1 m belong to no circle"),
        (ALL + "0.2,0.6,,1,\n", "line 2: has no radius, and not both chord and sagitta"),
        (ALL + "0.2,0.6,0.4,1,\n", "line 2: a chord of 1 m is longer than the diameter, 0.8 m"),
        (ALL + "0.2,0.6,3,1,0.25\n", "line 2: radius 3 m contradicts chord and sagitta, 2 m by Eq. (16)"),
        (
            "v_left,v_right,radius,direction\n0.2,0.6,1,right\n",
            "line 2: v_left 0.2 and v_right 0.6 m/s curve to the left, not to the right; are the sides swapped?",
        ),
        ("v_left,v_right,radius,direction\n0.2,0.6,1,up\n", "column 'direction': 'up' is neither left nor right"),
        ("v_left,v_right,radius,speed\n0.2,0.6,1,-2\n", "line 2: the speed over ground must be positive"),
    ],
)
def test_faults_are_named_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(DataError, match=f"^{re.escape(str(path))}.*{re.escape(message)}"):
        read_circle_runs(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.csv"):
        read_circle_runs(tmp_path / "none.csv")
