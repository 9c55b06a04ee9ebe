"""The folders are the architecture: imports only go down, and each door to the outside has one keeper."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted(path for package in ("gonio", "microsurfaces") for path in (ROOT / package).rglob("*.py"))

LEVELS = [
    {"gonio.__main__"},
    {"gonio.cli"},
    {"gonio.campaign"},
    {"gonio.experiment", "gonio.validation"},
    {"gonio.reporting"},
    {"gonio.plots", "gonio.rendering", "gonio.self_check", "gonio.fitting", "gonio.noise", "gonio.tables"},
    {"gonio.appearance", "gonio.comparison"},
    {"gonio.formats"},
    {"gonio.goniometer"},
    {"gonio.transport.embree"},
    {"gonio.transport.height_field"},
    {"gonio.transport.scene", "gonio.transport.source", "gonio.models", "gonio.measurement"},
    {"gonio.interpolation", "gonio.html_drawing"},
    {"gonio.detectors", "gonio.colour"},
    {"gonio.transport.accelerator", "gonio.optics", "gonio.sphere", "gonio.tally"},
    {"gonio.randomness"},
    {"microsurfaces"},
    {"microsurfaces.processes"},
    {"microsurfaces.random_fields", "microsurfaces.profiles", "microsurfaces.textures", "microsurfaces.files"},
    {"microsurfaces.height_field"},
    {"microsurfaces.mesh"},
    {"microsurfaces.recipe", "microsurfaces.html_card"},
]
"""From the command line down to the geometry; the modules of one level do not import each other."""

KEEPERS = {
    "embreex": "gonio.transport.scene",
    "matplotlib": "gonio.plots",
    "pyvista": "gonio.plots",
    "mitsuba": "gonio.rendering",
}


def module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def unit(name: str) -> str:
    """The module or sub-package that `name` belongs to, as `LEVELS` has it."""
    parts = name.split(".")
    return ".".join(parts[:2])


def imports(path: Path) -> set[str]:
    """What a file imports at run time; imports for type checkers only do not count."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing_only = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found = set()
    for node in set(ast.walk(tree)) - typing_only:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "gonio":
            found |= {f"gonio.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return found


@pytest.mark.parametrize("path", FILES, ids=module)
def test_imports_only_go_down(path: Path) -> None:
    level = {name: index for index, names in enumerate(LEVELS) for name in names}
    here = unit(module(path))
    if here == "gonio":
        return
    for name in imports(path):
        if name.split(".")[0] in ("gonio", "microsurfaces") and unit(name) != here and name != "gonio.__version__":
            assert level[unit(name)] > level[here], f"{here} imports {name}"


@pytest.mark.parametrize("path", FILES, ids=module)
def test_each_door_has_one_keeper(path: Path) -> None:
    for name in imports(path):
        keeper = KEEPERS.get(name.split(".")[0])
        assert keeper in (None, unit(module(path))), f"only {keeper} imports {name}"


@pytest.mark.parametrize("path", FILES, ids=module)
def test_only_the_command_line_prints_or_exits(path: Path) -> None:
    calls = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
    loud = {ast.unparse(call.func) for call in calls} & {"print", "exit", "sys.exit", "os._exit", "quit"}
    assert not loud or unit(module(path)) == "gonio.cli"
