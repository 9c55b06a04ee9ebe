"""What all commands have in common: the terminal, its progress and its sentences, and the files they are given."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from rich.console import Console

from gonio import __version__
from gonio.toml_files import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from gonio.experiment import Experiment
    from gonio.measurement import Measurement
    from microsurfaces import HeightField, Mesh


WIDTH = 100
"""No line is wider, however wide the terminal is."""

PLAIN_PROGRESS_SECONDS = 10.0
"""Where there is no terminal to draw a bar on, a line this often."""

FILE_SUFFIXES = {
    ".nc",
    ".toml",
    ".md",
    ".html",
    ".png",
    ".svg",
    ".pdf",
    ".jpg",
    ".gif",
    ".mp4",
    ".gltf",
    ".glb",
    ".vtp",
}
"""What no folder's name ends with."""

app = App(
    name="gonio",
    help="A virtual gonioreflectometer: a rough surface in, a measured BRDF with an error bar on every bin out.",
    help_epilogue="Start with: gonio run configs/gold_beckmann.toml",
    version=__version__,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
)

Flag = Annotated[bool, Parameter(negative="", show_default=False)]
Words = Annotated[tuple[str, ...], Parameter(negative="", show_default=False)]
"""An option that is repeated for each of its values."""
Overrides = Annotated[tuple[str, ...], Parameter(name="--set", negative="", show_default=False)]
Models = Annotated[tuple[str, ...], Parameter(name="--model", negative="", show_default=False)]
Numbers = Annotated[tuple[float, ...], Parameter(negative="", show_default=False, consume_multiple=(1, None))]
"""An option that takes one or several values: --wavelength 450 550."""
Output = Annotated[Path | None, Parameter(name=["--output", "-o"])]
"""The folder of all that a command writes; a command that writes a single file has --to."""


class RunError(Exception):
    """What went wrong while running, in one sentence."""


def complain(code: int, *sentences: str) -> int:
    """Print `sentences` to stderr; `code`, to exit with."""
    for sentence in sentences:
        print(sentence if sentence.endswith((".", "?", "!")) else f"{sentence}.", file=sys.stderr)
    return code


def check_writable(folder: Path, option: str = "--output") -> None:
    """Refuse a folder that results could not be written to, before a long run; creates nothing.

    Raises `InputError` where the name is that of a file, `RunError` where the system forbids it.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not existing.is_dir():
        raise InputError(f"{option} {folder}: {existing} is a file, not a folder.")
    if not folder.exists() and folder.suffix.lower() in FILE_SUFFIXES:
        raise InputError(f"{option} {folder}: must be a folder, and this is the name of a file.")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise RunError(f"{folder} cannot be written ({reason(error)}): give another folder with {option}.") from None


def make_writable(folder: Path, option: str = "--output") -> None:
    """Create `folder` where it does not exist; refuse, as `check_writable` does, what could not be written to."""
    check_writable(folder, option)
    folder.mkdir(parents=True, exist_ok=True)


def make_room(file: Path) -> None:
    """Create the folder of a file that will be written with --to; refuse a name that no file can have."""
    if file.is_dir():
        raise InputError(f"--to {file}: is a folder; give the name of a file.")
    make_writable(file.parent, "--to")


@contextlib.contextmanager
def telling_refusals(path: Path) -> Iterator[None]:
    """Raise `RunError` in place of what the system says when `path` cannot be written."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise RunError(f"{path} cannot be written ({reason(error)}).") from None


@contextlib.contextmanager
def telling_mistakes() -> Iterator[None]:
    """Raise `InputError` in place of a ValueError about what was asked for."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from None


def reason(error: OSError) -> str:
    """Why the system refused, in its own few words."""
    return (os.strerror(error.errno) if error.errno else str(error).split("\n")[0]).lower()


class Meter:
    """Counts rays and the time they took; `show` is called with paths done, paths in all, and rays per second."""

    def __init__(self, show: Callable[[int, int, float], None]) -> None:
        self._show = show
        self._last = time.monotonic()
        self._seconds = 0.0
        self.rays = 0

    def __call__(self, done: int, total: int, rays: int) -> None:
        """Note how many paths are done and how many rays that took."""
        now = time.monotonic()
        # Without new rays a kernel is being compiled, and a long pause is a surface being built.
        if rays > self.rays and now - self._last < 2:
            self._seconds += now - self._last
        self._last, self.rays = now, rays
        self._show(done, total, self.rate)

    @property
    def rate(self) -> float:
        """Rays per second of tracing."""
        return self.rays / max(self._seconds, 1e-3)


@contextlib.contextmanager
def progress(quiet: bool) -> Iterator[Meter]:
    """A bar on a terminal, a line every few seconds elsewhere, both on stderr."""
    if quiet:
        yield Meter(lambda done, total, rate: None)
    elif not sys.stderr.isatty():
        yield Meter(_plain_progress())
    else:
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

        columns = (BarColumn(None), TaskProgressColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), expand=True) as bar:
            task = bar.add_task("building the surface", total=None)
            yield Meter(
                lambda done, total, rate: bar.update(
                    task, completed=done, total=total, description=rays_per_second(rate)
                )
            )


def _plain_progress() -> Callable[[int, int, float], None]:
    """Prints a line of progress to stderr now and then."""
    started = last = time.monotonic()

    def show(done: int, total: int, rate: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PLAIN_PROGRESS_SECONDS and done:
            last, left = now, (now - started) * (total - done) / done
            complain(0, f"{done / total:4.0%} done, {rays_per_second(rate)}, {left:.0f} s left")

    return show


def rays_per_second(rate: float) -> str:
    """`rate` with its unit."""
    return f"{rate / 1e6:.1f} M rays/s" if rate >= 1e5 else f"{rate / 1e3:.0f} k rays/s"


def standard_output() -> Console:
    """Standard output, never wider than `WIDTH`."""
    console = Console(highlight=False)
    console.width = min(console.width, WIDTH)
    return console


def say(text: str, style: str | None = None) -> None:
    """Print a paragraph, wrapped at the terminal's width."""
    standard_output().print(text, style=style, markup=False)


def show_table(title: str, table: Table | None) -> None:
    """Print a table under its title; nothing if there is none."""
    if table is not None:
        say(title, style="bold")
        standard_output().print(table)


def open_window(relief: HeightField | Mesh) -> None:
    """Show a surface until its window is closed."""
    from gonio import plots
    from microsurfaces import Mesh

    try:
        plots.show_surface(relief if isinstance(relief, Mesh) else relief.mesh())
    except RuntimeError as error:
        raise RunError(f"No window: {error}") from None


def read_experiment(config: Path, overrides: Sequence[str], seed: int | None) -> Experiment:
    """The experiment of a file, with the command line's changes."""
    from gonio.experiment import Experiment

    return Experiment.read(config, (*overrides, *(() if seed is None else (f"seed={seed}",))))


@contextlib.contextmanager
def working(words: str) -> Iterator[None]:
    """Say on a terminal what takes a while."""
    if not sys.stderr.isatty():
        yield
        return
    with Console(stderr=True).status(words):
        yield


def refuse_folder(file: Path) -> None:
    """Raise `InputError` for a folder in place of a measurement's file."""
    if file.is_dir():
        within = file / "measurement.nc"
        raise InputError(f"{file} is a folder{f'; did you mean {within}?' if within.exists() else ': give a .nc file'}")


def load_measurement(file: Path) -> Measurement:
    """The measurement in a file, ours or another program's."""
    from gonio.formats import load

    refuse_folder(file)
    with telling_mistakes():
        return load(file)
