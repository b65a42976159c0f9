import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import skidsteer

SOURCE = Path(skidsteer.__file__).parent
ARCHITECTURE = SOURCE.parents[1] / "docs" / "architecture.md"

# Bottom to top: a room imports only from rooms before it. Rooms that are planned but not built yet may stand here.
ORDER = """
    errors progress se2 student vehicle drive kernels paths models windows gyro noise outliers heading prediction
    metrics multipliers calibration
    simulate rolling terramechanics mujoco_plant samples p3at laser
    io doctor identify evaluation
    odometry control plants follow plan export report figures reproduce
    documents console courses sources cli
"""
ROOMS = ORDER.split()
OPTIONAL = {"rosbags", "mcap", "matplotlib", "plotly", "pandas", "mujoco", "psutil"}  # inside functions only
HEAVY = {"numba", "llvmlite", "numpy", "scipy", "pandas", "plotly", "matplotlib", "rosbags"}  # not for --help


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    names = {}
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE.parent).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


MODULES = modules()


def imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names of everything imported anywhere in a module, also inside functions and for type checking."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute in this house"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def outside_functions(tree: ast.Module) -> ast.Module:
    """The statements that run on import; what stands under TYPE_CHECKING does not."""
    skip = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
    typing = {id(n) for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test)}

    def walk(node: ast.AST) -> Iterator[ast.stmt]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, skip) or id(child) in typing:
                continue
            if isinstance(child, (ast.Import, ast.ImportFrom)):
                yield child
            yield from walk(child)

    return ast.Module(list(walk(tree)), [])


def rooms_used(name: str) -> set[str]:
    own = imports(ast.parse(MODULES[name].read_text(encoding="utf-8")))
    return {parts[1] for i in own if (parts := i.split("."))[0] == "skidsteer" and len(parts) > 1}


def test_every_room_has_its_place() -> None:
    there = {name.split(".")[1] for name in MODULES if "." in name}
    assert there <= set(ROOMS), "put the new room where it belongs in ROOMS"
    assert len(ROOMS) == len(set(ROOMS))


@pytest.mark.parametrize("name", [name for name in MODULES if name != "skidsteer"])
def test_a_room_imports_only_from_rooms_below(name: str) -> None:
    room = name.split(".")[1]
    below = set(ROOMS[: ROOMS.index(room) + 1])
    assert rooms_used(name) <= below


def test_the_documented_order_is_this_one() -> None:
    if not ARCHITECTURE.is_file():
        pytest.skip("no documentation beside an installed package")
    first_cells = re.findall(r"^\| (`[^|]+) \|", ARCHITECTURE.read_text(encoding="utf-8"), re.MULTILINE)
    documented = [name.strip("/") for cell in first_cells for name in re.findall(r"`([a-z0-9_]+)/?`", cell)]
    known = [name for name in documented if name in ROOMS]
    assert len(known) > 10
    assert known == sorted(known, key=ROOMS.index)


@pytest.mark.parametrize("name", list(MODULES))
def test_no_module_imports_one_that_imports_it(name: str) -> None:
    """Cycles inside a room, too."""
    seen: set[str] = set()
    todo = [name]
    while todo:
        tree = outside_functions(ast.parse(MODULES[todo.pop()].read_text(encoding="utf-8")))
        for target in imports(tree):
            module = target if target in MODULES else target.rpartition(".")[0]
            if module in MODULES and module not in seen and module != "skidsteer":
                seen.add(module)
                todo.append(module)
    package = name.count(".") == 1 and MODULES[name].name == "__init__.py"
    assert name not in seen or package


def test_only_the_kernels_are_compiled() -> None:
    users = {n for n in MODULES for i in imports(ast.parse(MODULES[n].read_text())) if i.split(".")[0] == "numba"}
    assert users
    assert all(name.startswith("skidsteer.kernels.") for name in users)


@pytest.mark.parametrize("name", list(MODULES))
def test_optional_packages_are_imported_where_they_are_needed(name: str) -> None:
    tree = outside_functions(ast.parse(MODULES[name].read_text(encoding="utf-8")))
    assert not {i.split(".")[0] for i in imports(tree)} & OPTIONAL


@pytest.mark.parametrize("name", ["skidsteer", "skidsteer.cli"])
def test_importing_the_command_line_is_light(name: str) -> None:
    if name not in MODULES:
        pytest.skip("not built yet")
    code = f"import sys, {name}; print(*sorted({{m.split('.')[0] for m in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & HEAVY


def test_public_names_are_there() -> None:
    for name in skidsteer.__all__:
        assert getattr(skidsteer, name).__name__ == name
        assert getattr(skidsteer, name).__name__ == name  # a module of that name would take its place once imported
    with pytest.raises(AttributeError, match=r"^module 'skidsteer' has no attribute 'nothing'$"):
        _ = skidsteer.nothing
