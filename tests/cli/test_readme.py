"""The README keeps its promises: its Python runs, its files exist, its commands are commands."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", TEXT, flags=re.M | re.S)


def run(code, folder):
    """Run `code` as a script of its own in `folder`, warnings as errors."""
    script = folder / "readme.py"
    script.write_text(code, encoding="utf-8")
    command = [sys.executable, "-W", "error", script.name]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment(), timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def environment():
    return {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}


def test_the_eight_lines_run(tmp_path):
    lines = [line for line in BLOCKS[0].splitlines() if line.strip() and not line.startswith("import")]
    assert len(lines) == 8
    printed = run(BLOCKS[0], tmp_path)
    assert "albedo" in printed
    assert "CookTorrance" in printed
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gold.nc", "readme.py", "slices.png"]


def test_the_new_surface_runs(tmp_path):
    """The mean square slope of a sine wave is (2 pi amplitude / pitch)^2 / 2, less its finite differences' 5e-5."""
    assert len([line for line in BLOCKS[1].splitlines() if line.strip() and '"""' not in line]) <= 15
    use = "print(Ripples(amplitude=0.5).build(seed=0).mesh().statistics().rms_slope_x)"
    measured = float(run(BLOCKS[1] + use, tmp_path))
    assert measured == pytest.approx(3.14159265 * 0.05 / 2**0.5, rel=1e-4)


def test_every_file_it_names_exists():
    named = re.findall(r"`((?:gonio|microsurfaces|configs|docs|tests)/[\w./]*)`|\]\((\S+?)\)", TEXT)
    paths = {a or b for a, b in named} | set(re.findall(r"configs/\w+\.toml", TEXT))
    assert len(paths) > 15
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_its_pictures_are_small():
    for name in re.findall(r"!\[.*?\]\((\S+)\)", TEXT):
        assert (ROOT / name).stat().st_size < 300_000


def test_its_commands_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), flags=re.M))
    assert set(re.findall(r"^    make (\w+)", TEXT, flags=re.M)) <= targets
    command = [sys.executable, "-m", "gonio", "--help"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment(), check=True).stdout
    for name in ("run", "list", "surface", "compare", "plot", "export"):
        assert re.search(rf"\b{name}\b", printed)


def test_it_names_the_supported_pythons():
    project = (ROOT / "pyproject.toml").read_text()
    assert 'requires-python = ">=3.11"' in project
    assert "Python 3.11 to 3.14" in TEXT
    assert "apt-get install libegl1" in TEXT
