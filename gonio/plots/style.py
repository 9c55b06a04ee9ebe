"""What every figure shares: the palette, the choice of what is shown, heads, colour bars, saving.

matplotlib is used through `Figure` objects and never through pyplot, so nothing global changes, no window opens and no
figure stays open. Files appear whole or not at all.
"""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from gonio.measurement import Measurement
    from gonio.models import Model

PathLike = str | os.PathLike[str]

PANELS = 6
"""At most so many incidences share a figure."""
SOURCE, SPECULAR, INK, PAPER = "#d98200", "#0072b2", "#333333", "#e9e9e6"
"""Incident and specular direction, lines and letters, the sample's plane: the same colours in every figure."""
COLOURS, ERRORS, DIFFERENCES = "viridis", "magma", "RdBu_r"
"""Colour maps of values, of their errors and of differences."""
PERCENT, SIGMAS = 50.0, 6.0
"""Largest differences that a map tells apart: in percent, and in standard errors."""
SPARSE = 10
"""Bins with a smaller count than this are hatched where errors are shown."""
DECADES = 4
"""At most so many decades are shown."""
CURVES = 5
"""At most so many wavelengths share a panel."""
STYLES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1.2, 1.4)), (0, (6, 2, 1.2, 2)))
"""Lines of all orders together and of the first few numbers of hits."""
MARKERS = "osD^vP"
"""Of the first few models."""
ORDERS = {"all": "#8a8a86", "1": SPECULAR, "2": "#009e73"}
"""Numbers of hits, where they are told apart by colours."""
MORE = "#cc79a7"
"""And still more hits."""
FITTED = ("#cc79a7", "#009e73", "#56b4e9", "#b2182b")
"""Of the first few models, where they are curves."""


@dataclass(frozen=True, eq=False)
class Incidence:
    """One measured incidence: its angles in degrees and its part of the dataset."""

    theta: float
    phi: float
    data: xr.Dataset

    @property
    def words(self) -> str:
        """The angles of the light, for a title."""
        return f"$\\theta_i$ = {self.theta:g}°, $\\phi_i$ = {self.phi:g}°"


def choose_incidences(
    measurement: Measurement, panels: int = PANELS, theta_i: float | None = None, phi_i: float | None = None
) -> tuple[list[Incidence], str]:
    """At most so many measured incidences, by azimuth and polar angle, and words that say how many there are.

    Azimuths share the panels evenly; where there are too many of them, the first alone is shown. `theta_i` and `phi_i`,
    degrees, leave only the incidences at these measured angles. Raises ValueError if none is left.
    """
    measured = asked_for(measurement, theta_i, phi_i)
    azimuths = np.flatnonzero(measured.any(axis=0))
    many, whole = len(azimuths) > panels // 2, int(measured.sum())
    if many and whole > panels:
        azimuths = azimuths[:1]
    each = panels if whole <= panels else max(panels // len(azimuths), 1)
    chosen = [(i, j) for j in azimuths for i in thinned(np.flatnonzero(measured[:, j]), each)]
    words = "" if len(chosen) == whole else f"{len(chosen)} of {whole} incidences"
    return [incidence_at(measurement, int(i), int(j)) for i, j in chosen], words


def asked_for(measurement: Measurement, theta_i: float | None, phi_i: float | None) -> NDArray[np.bool_]:
    """Which incidences (theta_i, phi_i) were measured, of those at the angles that are asked for."""
    if not measurement.measured.any():
        raise ValueError("no incidence of this measurement was measured: nothing to draw")
    kept = measurement.measured.copy()
    for axis, (name, angle) in enumerate({"theta_i": theta_i, "phi_i": phi_i}.items()):
        if angle is None:
            continue
        here = np.isclose(measurement.dataset[name].values, angle, rtol=0.0, atol=1e-6)
        kept &= here[:, None] if axis == 0 else here
        if not kept.any():
            known = measurement.dataset[name].values[measurement.measured.any(axis=1 - axis)]
            listed = ", ".join(f"{value:g}" for value in known)
            raise ValueError(f"{name} = {angle:g} was not measured: choose one of {listed} degrees")
    return kept


def the_incidence(measurement: Measurement, theta_i: float | None, phi_i: float | None) -> Incidence:
    """The one incidence that is drawn into axes of the caller's; ValueError if several could be meant."""
    kept = asked_for(measurement, theta_i, phi_i)
    if kept.sum() > 1:
        raise ValueError(
            f"ax shows one incidence, and {kept.sum()} were measured: choose by theta_i and phi_i, degrees"
        )
    ((i, j),) = np.argwhere(kept)
    return incidence_at(measurement, int(i), int(j))


def incidence_at(measurement: Measurement, i: int, j: int) -> Incidence:
    """One incidence by its places along theta_i and phi_i."""
    data = measurement.dataset
    return Incidence(float(data["theta_i"][i]), float(data["phi_i"][j]), data.isel(theta_i=i, phi_i=j))


def thinned(values: NDArray[Any], most: int) -> NDArray[Any]:
    """At most so many of `values`, evenly chosen, the first and the last among them."""
    chosen = np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int))
    return np.asarray(values[chosen])


def nearest_wavelength(measurement: Measurement, wanted: float | None) -> float:
    """The measured wavelength nearest to `wanted`, or to the middle of the visible range, 550 nm."""
    wavelengths = np.asarray(measurement.wavelengths, float)
    return float(wavelengths[np.abs(wavelengths - (550.0 if wanted is None else wanted)).argmin()])


def channel(measurement: Measurement, nm: float) -> str:
    """What the values at one of the measured wavelengths are called."""
    return measurement.channels[int(np.flatnonzero(measurement.wavelengths == nm)[0])]


def channel_words(measurement: Measurement, nm: float) -> str:
    """The same for a title, where "R" alone would be a riddle."""
    name = channel(measurement, nm)
    return name if name.endswith(" nm") else f"channel {name}"


def counts(data: xr.Dataset) -> bool:
    """Whether arrivals were counted; they are not in an external measurement."""
    return "count" in data


def has_errors(measurement: Measurement) -> bool:
    """Whether any standard error is known."""
    return bool(np.isfinite(measurement.dataset["brdf_standard_error"].values).any())


def has_hemisphere(measurement: Measurement) -> bool:
    """Whether there is a grid of bins; apertures have none."""
    return "dphi" in measurement.dataset.dims


def layout(panels: int, incidences: Sequence[Incidence]) -> tuple[int, int]:
    """(rows, columns) of the panels; one row an azimuth where that comes out even."""
    azimuths = len({incidence.phi for incidence in incidences})
    columns = panels // azimuths if azimuths > 1 and panels % azimuths == 0 else panels
    columns = columns if columns <= 3 else 2 if panels == 4 else 3
    return -(-panels // columns), columns


def headline(figure: Figure, measurement: Measurement, *parts: str) -> None:
    """The measurement's title above what this figure shows, in as many lines as the width asks for."""
    title = str(measurement.dataset.attrs.get("title", "")).strip()
    shown = ", ".join(part for part in parts if part)
    room = int(11 * figure.get_figwidth())
    lines = [line for text in (title, shown) for line in textwrap.wrap(text, room)]
    figure.suptitle("\n".join(lines).replace("$", r"\$"), fontsize=12, color=INK)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, 150 dots each."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from gonio.plots.notebook import NotebookFigure

    figure = NotebookFigure(figsize=(width, height), dpi=150, facecolor="white")
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained", h_pad=0.07, w_pad=0.05)
    return figure


def check_path(path: Path, suffixes: Sequence[str] = ()) -> None:
    """Raise ValueError for a suffix that is not one of matplotlib's, or of these; FileNotFoundError without a
    folder."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    known = suffixes or [f".{name}" for name in FigureCanvasAgg.get_supported_filetypes()]
    if path.suffix.lower() not in known:
        raise ValueError(f"cannot draw into {str(path)!r}: the suffixes are {', '.join(known)}")
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path.parent))


def save(figure: Figure, path: PathLike) -> Path:
    """Write a figure into the kind of file that the suffix tells; a ValueError for one that matplotlib cannot write."""
    path = Path(path)
    check_path(path)
    with atomic_write(path) as temporary:
        figure.savefig(temporary)
    return path


def finished(figure: Figure, path: PathLike | None) -> Figure:
    """The figure, which is also written into `path` if there is one."""
    if path is not None:
        save(figure, path)
    return figure


def figure_of(ax: Axes) -> Figure:
    """The whole figure that axes belong to, also if they stand in a part of it."""
    from matplotlib.figure import Figure

    figure = ax.figure
    return figure if isinstance(figure, Figure) else figure.figure


def colour_bar(figure: Figure, panels: Any, norm: Normalize, words: str, colours: str = COLOURS) -> Colorbar:
    """A colour bar beside `panels` with round numbers on it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    bar = figure.colorbar(ScalarMappable(norm, colours), ax=list(np.ravel(panels)), shrink=0.85, aspect=28, pad=0.015)
    bar.set_label(words, fontsize=10, color=INK)
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 1.0)
    if isinstance(norm, LogNorm) and high < 300 * low:
        rounds = np.outer(10.0 ** np.arange(-12, 12), (1, 2, 5)).ravel()
        ticks = rounds[(rounds >= low) & (rounds <= high)]
        bar.set_ticks(list(ticks), labels=[f"{tick:g}" for tick in ticks])
        bar.minorticks_off()
    bar.ax.tick_params(labelsize=9)
    return bar


def hits(order: str) -> str:
    """An order of scattering in words."""
    words = {"all": "all orders", "1": "1 hit"}
    return words.get(order, f"{order[:-1]} and more hits" if order.endswith("+") else f"{order} hits")


def hue(nm: float) -> tuple[float, float, float]:
    """The spectral hue of a wavelength, dark enough for a white page; greys outside the visible range."""
    if not 380 <= nm <= 780:
        return (0.45, 0.45, 0.5) if nm < 380 else (0.3, 0.25, 0.25)
    nodes = (380, 420, 450, 480, 500, 530, 555, 580, 600, 620, 660, 780)
    red = (0.42, 0.40, 0.13, 0.00, 0.00, 0.05, 0.25, 0.75, 0.88, 0.86, 0.78, 0.45)
    green = (0.10, 0.12, 0.30, 0.55, 0.60, 0.60, 0.58, 0.55, 0.42, 0.20, 0.05, 0.00)
    blue = (0.60, 0.75, 0.85, 0.80, 0.55, 0.25, 0.05, 0.00, 0.00, 0.10, 0.12, 0.05)
    r, g, b = (float(np.interp(nm, nodes, channel)) for channel in (red, green, blue))
    return r, g, b


def names_of(models: Sequence[Model | BRDF]) -> list[str]:
    """What models are called in a legend: their classes; where these are equal with what differs, or with numbers."""
    classes = [model.title if isinstance(model, BRDF) else type(model).__name__ for model in models]
    names = list(classes)
    for part in ("distribution", "masking"):
        kinds = [type(getattr(model, part, None)).__name__ for model in models]
        for k, (name, kind) in enumerate(zip(classes, kinds, strict=True)):
            if {other for same, other in zip(classes, kinds, strict=True) if same == name} != {kind}:
                names[k] += f" ({kind})"
    return [f"{name} {names[: k + 1].count(name)}" if names.count(name) > 1 else name for k, name in enumerate(names)]


@cache
def can_render() -> bool:
    """Whether VTK can draw off screen; tried in a process of its own, which without a GL library is killed."""
    trial = (
        "import sys, vtkmodules.vtkRenderingOpenGL2, vtkmodules.vtkRenderingCore as vtk; view = vtk.vtkRenderWindow(); "
        "view.SetOffScreenRendering(True); view.Render(); sys.exit(not view.SupportsOpenGL())"
    )
    try:
        return subprocess.run([sys.executable, "-c", trial], capture_output=True, timeout=120).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def log_norm(values: Floats) -> Normalize:
    """From the lowest values, a few noisy ones left out, to the highest: half a decade to `DECADES`."""
    from matplotlib.colors import LogNorm

    values = values[values > 0]
    high = float(values.max(initial=0.0)) or 1.0
    low = float(np.quantile(values, 0.02)) if values.size else high
    return LogNorm(min(max(low, high / 10**DECADES), high / 3), high, clip=True)


def order_lines(data: xr.Dataset) -> dict[str, Any]:
    """The orders that are drawn, with their lines."""
    return dict(zip(map(str, data["order"].values), STYLES, strict=False))


def some_wavelengths(measurement: Measurement) -> tuple[list[float], str]:
    """At most `CURVES` of the measured wavelengths, evenly thinned, and words that say so."""
    wavelengths = [float(nm) for nm in measurement.wavelengths]
    chosen = [float(nm) for nm in thinned(measurement.wavelengths, CURVES)]
    return chosen, "" if len(chosen) == len(wavelengths) else f"{len(chosen)} of {len(wavelengths)} wavelengths"
