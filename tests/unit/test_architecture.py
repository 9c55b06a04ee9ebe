"""The folders are the architecture: imports only go down, and each door to the outside has one keeper."""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted(path for package in ("gonio", "microsurfaces") for path in (ROOT / package).rglob("*.py"))

LEVELS = [
    {"gonio.__main__"},
    {"gonio.cli"},
    {"gonio.reporting"},
    {"gonio.campaign"},
    {"gonio.experiment", "gonio.validation"},
    {"gonio.plots", "gonio.rendering", "gonio.self_check", "gonio.fitting", "gonio.noise", "gonio.tables"},
    {"gonio.appearance", "gonio.comparison"},
    {"gonio.formats"},
    {"gonio.brdf"},
    {"gonio.goniometer", "gonio.netcdf"},
    {"gonio.transport"},
    {"gonio.measurement", "gonio.models"},
    {"gonio.interpolation", "gonio.html_drawing"},
    {"gonio.detectors", "gonio.colour"},
    {"gonio.optics", "gonio.sphere", "gonio.tally"},
    {"gonio.randomness"},
    {"gonio.toml_files", "gonio.wording"},
    {"microsurfaces"},
    {"microsurfaces.random_fields", "microsurfaces.profiles", "microsurfaces.files"},
    {"microsurfaces.height_field"},
    {"microsurfaces.mesh"},
    {"microsurfaces.recipe", "microsurfaces.html_card", "microsurfaces.atomic_write", "microsurfaces.seeds"},
    {"microsurfaces.arrays"},
]
"""From the command line down to the geometry; the modules of one level do not import each other."""

KEEPERS = {
    "embreex": "gonio.transport",
    "matplotlib": "gonio.plots",
    "mitsuba": "gonio.rendering",
    "pyvista": "gonio.plots",
}


def module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module(path): path for path in FILES}


def unit(name: str) -> str:
    """The module or sub-package that `name` belongs to, as `LEVELS` has it."""
    parts = name.split(".")
    return ".".join(parts[:2])


@functools.cache
def statements(path: Path, typing_too: bool = False) -> list[ast.Import | ast.ImportFrom]:
    """The imports of a file, those inside functions too; those for type checkers only if asked for."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing_only = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    return [node for node in found if typing_too or node not in typing_only]


def imports(path: Path) -> set[str]:
    """The modules that a file imports at run time."""
    found = set()
    for node in statements(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
            continue
        of = {f"{node.module}.{alias.name}" for alias in node.names}
        found |= {name if name in MODULES else node.module or "" for name in of}
    return found - {"gonio"}


@pytest.mark.parametrize("path", FILES, ids=module)
def test_imports_only_go_down(path: Path) -> None:
    level = {name: index for index, names in enumerate(LEVELS) for name in names}
    here = unit(module(path))
    if here == "gonio":
        return
    for name in imports(path):
        if name.split(".")[0] in ("gonio", "microsurfaces") and unit(name) != here:
            assert level[unit(name)] > level[here], f"{here} imports {name}"


def test_inside_packages_no_import_goes_round_in_a_circle() -> None:
    graph = {
        name: {other for other in imports(path) if other in MODULES and other != name} - {"gonio"}
        for name, path in MODULES.items()
        if name != "gonio"
    }
    list(graphlib.TopologicalSorter(graph).static_order())


@pytest.mark.parametrize("path", FILES, ids=module)
def test_every_imported_name_exists(path: Path) -> None:
    for node in statements(path, typing_too=True):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ("gonio", "microsurfaces"):
            there = importlib.import_module(node.module or "")
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                assert name in MODULES or hasattr(there, alias.name), f"{module(path)} imports {name}"


def test_levels_name_what_there_is() -> None:
    units = {unit(name) for name in MODULES} - {"gonio"}
    named = [name for names in LEVELS for name in names]
    assert sorted(named) == sorted(units)


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
