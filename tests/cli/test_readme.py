"""The README and the pages of docs/ keep their promises: their Python runs, their files exist, their commands do."""

import importlib.util
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}


def name(path):
    return path.relative_to(ROOT).as_posix()


def text(path):
    return path.read_text(encoding="utf-8")


def blocks(path):
    """The Python of a page, block after block."""
    return re.findall(r"^```python\n(.*?)^```", text(path), flags=re.M | re.S)


def links(path):
    """Where the links and pictures of a page lead, other sites left out, with what stands after a #."""
    return [link for link in re.findall(r"\]\(([^)\s]+)\)", text(path)) if "://" not in link]


def commands(path):
    """The commands of a page's indented blocks: words, without comments, one line each."""
    lines = re.findall(r"^    ((?:gonio|make|python) .*)$", text(path), flags=re.M)
    return [shlex.split(line, comments=True) for line in lines]


def run(code, folder):
    """Run `code` as a script of its own in `folder`, warnings as errors."""
    script = folder / "script.py"
    script.write_text(code, encoding="utf-8")
    command = [sys.executable, "-W", "error", script.name]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=ENVIRONMENT, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


# --- The README -------------------------------------------------------------------------------------------------------


def test_it_is_read_in_three_minutes():
    assert len(text(README).splitlines()) <= 150


def test_its_eight_lines_run(tmp_path):
    (code,) = blocks(README)
    lines = [line for line in code.splitlines() if line.strip() and not line.startswith("import")]
    assert len(lines) == 8
    printed = run(code, tmp_path)
    assert "albedo" in printed
    assert "CookTorrance" in printed
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gold.nc", "script.py", "slices.png"]


def test_it_names_the_supported_pythons():
    assert 'requires-python = ">=3.11"' in text(ROOT / "pyproject.toml")
    assert "Python 3.11 to 3.14" in text(README)
    assert "apt-get install libegl1" in text(README)


def test_its_speeds_are_those_of_the_benchmarks():
    spec = importlib.util.spec_from_file_location("speed_table", ROOT / "docs/speed_table.py")
    speed_table = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(speed_table)
    measured = speed_table.speeds(text(ROOT / "benchmarks/RESULTS.md"))
    chosen = [row for row in measured if row[0] in speed_table.IN_README]
    assert speed_table.table(speed_table.HEAD, chosen) in text(README)
    assert speed_table.table(speed_table.HEAD + speed_table.MANY, measured) in text(ROOT / "docs/performance.md")


# --- All pages --------------------------------------------------------------------------------------------------------


def test_the_index_has_every_page():
    there = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert there <= set(links(ROOT / "docs/README.md"))


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_every_link_leads_somewhere(path):
    for link in links(path):
        file, _, heading = link.partition("#")
        target = path.parent / unquote(file) if file else path
        assert target.exists(), link
        if heading:
            titles = re.findall(r"^#+ (.*)$", text(target), flags=re.M)
            assert heading in {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}, link


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_every_file_it_names_exists(path):
    named = re.findall(r"`((?:gonio|microsurfaces|configs|docs|tests|benchmarks)/[\w./]*)`", text(path))
    planned = {"microsurfaces/slope_fields.py"}
    named += re.findall(r"configs/\w+\.toml", text(path))
    assert [file for file in named if not (ROOT / file).exists() and file not in planned] == []


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_pictures_are_small(path):
    for picture in re.findall(r"!\[.*?\]\((\S+)\)", text(path)):
        assert (path.parent / picture).stat().st_size < 300_000


def test_make_has_the_targets_that_are_named():
    targets = set(re.findall(r"^([a-z-]+):", text(ROOT / "Makefile"), flags=re.M))
    named = {words[1] for path in PAGES for words in commands(path) if words[0] == "make"}
    named |= {target for path in PAGES for target in re.findall(r"`make ([a-z-]+)`", text(path))}
    assert named <= targets
    assert {"demo", "test", "check"} <= named


def test_scripts_that_are_named_exist():
    named = {words[1] for path in PAGES for words in commands(path) if words[0] == "python"}
    assert [script for script in named if not (ROOT / script).exists()] == []


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_commands_are_commands(path, capsys):
    """Every `gonio ...` of a page is understood: the command there is, its flags, how many arguments it takes."""
    from gonio.cli import app

    for words in commands(path):
        if words[0] == "gonio" and "COMMAND" not in words:
            command, bound, _ = app.parse_args(words[1:], exit_on_error=False, print_error=False)
            assert command.__module__.startswith("gonio."), words
            assert bound is not None
    capsys.readouterr()


@pytest.mark.parametrize("page", ["models.md", "surfaces.md"])
def test_examples_of_other_pages_run(page, tmp_path):
    (code,) = blocks(ROOT / "docs" / page)
    assert run(code, tmp_path)


# --- Extending --------------------------------------------------------------------------------------------------------


def test_the_new_surface_runs(tmp_path):
    """The mean square slope of a sine wave is (2 pi amplitude / pitch)^2 / 2, less its finite differences' 5e-5."""
    (code,) = blocks(ROOT / "docs/extending.md")
    assert len([line for line in code.splitlines() if line.strip() and '"""' not in line]) <= 15
    use = "print(Ripples(amplitude=0.5).build(seed=0).mesh().statistics().rms_slope_x)"
    measured = float(run(code + use, tmp_path))
    assert measured == pytest.approx(3.14159265 * 0.05 / 2**0.5, rel=1e-4)
