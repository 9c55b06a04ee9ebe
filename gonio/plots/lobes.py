"""BRDF in three dimensions: scattered light as a surface around the sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gonio.brdf import BRDF
from gonio.colour import encoded, rgb_weights, xyz_of_rgb
from gonio.comparison import predicted
from gonio.detectors import HemisphereGrid, Klems
from gonio.plots import patches
from gonio.plots.lobe_scene import Ground, Scale, Shell, View, draw, open_window, window_axes
from gonio.plots.style import (
    COLOURS,
    DIFFERENCES,
    MARKERS,
    MORE,
    ORDERS,
    PANELS,
    PERCENT,
    Incidence,
    PathLike,
    channel_words,
    check_path,
    choose_incidences,
    colour_bar,
    counts,
    figure_of,
    finished,
    has_hemisphere,
    headline,
    hits,
    layout,
    names_of,
    nearest_wavelength,
    new_figure,
)
from gonio.sphere import direction
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gonio.measurement import Measurement
    from gonio.models import Model
    from microsurfaces import HeightField

WINDOWS = 3
"""At most so many lobes stand side by side in a window."""
CLEAR, VEILED, SOLID = 0.22, 0.55, 1.0
"""Opacities: of the light of all orders around its parts, of lobes in one another, and of a lobe by itself."""
VECTORS = (".svg", ".svgz", ".pdf", ".eps", ".ps")
"""Files that hold lines and facets; other pictures may be rendered by VTK."""


@dataclass(frozen=True, eq=False)
class LobeStyle:
    """How lobes are drawn.

    >>> plots.lobes(measurement, "lobes.png", style=plots.LobeStyle(radius="log", overlaid=True))  # doctest: +SKIP
    """

    radius: Literal["linear", "log"] | None = None
    """Scale of the radius, "log" over three decades. None is "log" where a lobe is so narrow, or the panels so
    different, that "linear" would show a needle or nothing."""
    orders: bool = False
    """Nest translucent lobes of 1, 2 and more hits in that of all light."""
    overlaid: bool = False
    """Put translucent lobes of all incidences of one azimuth into one panel."""
    true_colour: bool = False
    """Colour a spectrum as the eye sees it under D65, each direction as bright as the albedo; the radius is then
    luminance."""
    ground: HeightField | None = None
    """A relief to draw, true to scale and hugely enlarged, as the plane under the lobe."""


PLAIN = LobeStyle()
"""The style unless told."""


def lobes(
    measurement: Measurement,
    path: PathLike | None = None,
    *,
    models: Sequence[Model | BRDF] = (),
    wavelength: float | None = None,
    theta_i: float | None = None,
    phi_i: float | None = None,
    style: LobeStyle = PLAIN,
    ax: Axes | None = None,
) -> Figure:
    """Draw the lobes, BRDF times cos(theta_o), as surfaces in space; a figure, also written into `path`.

    A panel an incidence, of all measured ones or of those at `theta_i` and `phi_i`, degrees; a picture of one panel
    goes into `ax`. The radius in a direction is the light scattered into it (1/sr), averaged over patches of about 3
    degrees with the solid angle as weight. Radius and colour have one scale for all panels, which the figure tells.
    `wavelength` (nm; the nearest measured one) is 550 nm unless told. Where nothing is known a lobe has a hole.

    `models` stand beside what was measured, at the order of scattering that they describe; of a single one the relative
    difference is shown as well, in the colours of the measured lobe. `style` is a `LobeStyle`.

    Lobes are rendered by VTK, or by matplotlib where no GL library is installed; .svg and .pdf hold true vectors. See
    `lobe_film` for lobes that move over theta_i, `lobe_meshes` for lobes in other programs, `show_lobes` for a window
    and `interactive` for a notebook. Raises ValueError for a measurement without a hemisphere of bins and for what
    cannot go together.
    """
    if path is not None:
        check_path(Path(path))
    scene = LobeScene.of(measurement, models, wavelength, style, (theta_i, phi_i))
    if ax is None:
        return finished(scene.figure(path is not None and Path(path).suffix.lower() in VECTORS), path)
    if len(scene.views) > 1:
        raise ValueError(f"ax shows one panel, and here are {len(scene.views)}: choose by theta_i and phi_i, degrees")
    figure = figure_of(ax)
    scene.fill(figure, np.array([[ax]]), path is not None and Path(path).suffix.lower() in VECTORS)
    return finished(figure, path)


def show_lobes(
    measurement: Measurement,
    *,
    models: Sequence[Model | BRDF] = (),
    wavelength: float | None = None,
    style: LobeStyle = PLAIN,
) -> None:
    """Open a window with the first lobes, as `lobes` draws them, to be turned by the mouse; return when it is closed.

    Raises RuntimeError where there is no screen, or no GL library to draw with.
    """
    scene = LobeScene.of(measurement, models, wavelength, style)
    open_window(scene.views[:WINDOWS], scene.scale, scene.ground)


@dataclass(frozen=True, eq=False)
class LobeScene:
    """Everything that is drawn of a measurement, before it is drawn."""

    measurement: Measurement
    views: Sequence[View]
    scale: Scale
    ground: Ground | None
    words: Sequence[str]
    """What the caption says."""

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        models: Sequence[Model | BRDF] = (),
        wavelength: float | None = None,
        style: LobeStyle = PLAIN,
        angles: tuple[float | None, float | None] = (None, None),
        moving: bool = False,
    ) -> LobeScene:
        """At the incidences of `angles` (theta_i, phi_i) if they are given; `moving` if its incidences are frames."""
        stepped = isinstance(measurement.detector, Klems)
        measurement = on_grid(measurement)
        _check(measurement, models, style)
        nm = nearest_wavelength(measurement, wavelength)
        subject = _Subject(measurement, nm, style.true_colour, stepped, moving)
        views, choice = _views(subject, models, style, angles)
        scale = Scale.of([shell.value for view in views for shell in view.shells], style.radius)
        ground = None if style.ground is None else Ground.of(style.ground)
        return cls(measurement, views, scale, ground, (*_words(subject, views, scale, ground), choice))

    def figure(self, vector: bool = False) -> Figure:
        """Panels, colour bars, legend and caption."""
        rows, columns = _panels(self.views)
        figure = new_figure(max(4.4 * columns + 0.9, 6.4), 3.25 * rows + 0.95)
        self.fill(figure, figure.subplots(rows, columns, squeeze=False), vector)
        headline(figure, self.measurement, *self.words)
        if self.views[0].legend:
            handles = _legend(self.views[0])
            figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
        return figure

    def fill(self, figure: Figure, panels: Any, vector: bool) -> None:
        """Draw the views into `panels` (rows, columns), and colour bars beside them."""
        for panel, view in zip(panels.flat, self.views, strict=False):
            draw(panel, view, self.scale, self.ground, vector)
        for panel in panels.flat:
            window_axes(panel)
        for norm, label, colours in _bars(self.views, self.scale):
            colour_bar(figure, panels, norm, label, colours)


def _panels(views: Sequence[View]) -> tuple[int, int]:
    """(rows, columns): one row an incidence where models stand beside what was measured."""
    beside = sum(view.incidences == views[0].incidences for view in views)
    return (len(views) // beside, beside) if beside > 1 else layout(len(views), [view.incidences[0] for view in views])


def _bars(views: Sequence[View], scale: Scale) -> list[tuple[Any, str, str]]:
    """Scales, labels and maps of the colours that stand for numbers."""
    from matplotlib.colors import Normalize

    paints = {type(shell.paint) if shell.paint is not None else None for view in views for shell in view.shells}
    bars = [(scale.norm, r"BRDF $\cdot\,\cos\theta_o$  (sr⁻¹)", COLOURS)] if None in paints else []
    if any(view.differs for view in views):
        bars.append((Normalize(-PERCENT, PERCENT), "model / measured - 1 (%)", DIFFERENCES))
    return bars


def _legend(view: View) -> list[Any]:
    from matplotlib.patches import Patch

    return [Patch(color=colour, alpha=0.6, label=label) for label, colour in view.legend.items()]


def _check(measurement: Measurement, models: Sequence[Model | BRDF], style: LobeStyle) -> None:
    """Raise ValueError for what cannot be drawn."""
    if not has_hemisphere(measurement):
        raise ValueError(
            "lobes need a hemisphere of bins, and this measurement was made with Apertures; "
            "draw slices, or measure with detector = HemisphereGrid"
        )
    if sum((bool(models), style.orders, style.overlaid)) > 1:
        raise ValueError("lobes show one at a time: models, orders or overlaid incidences; draw several pictures")
    if style.orders and (style.true_colour or len(measurement.dataset["order"]) < 2):
        raise ValueError(
            "orders have colours of their own, not the true ones: draw two pictures"
            if style.true_colour
            else "this measurement does not tell the orders of scattering apart: draw it without orders"
        )
    if len(models) > len(MARKERS) // 2:
        raise ValueError(f"{len(models)} models are too many beside one another: name {len(MARKERS) // 2} at most")


def on_grid(measurement: Measurement) -> Measurement:
    """Klems's patches as a hemisphere of bins, each with the value of its patch."""
    if not isinstance(measurement.detector, Klems):
        return measurement
    chosen, _ = choose_incidences(measurement)
    theta, phi = [incidence.theta for incidence in chosen], [chosen[0].phi]
    return BRDF.of(measurement).sampled(theta, phi, HemisphereGrid(theta_step=2.5, phi_step=5.0), nodes=1)


@dataclass(frozen=True, eq=False)
class _Subject:
    """What is drawn of a measurement."""

    measurement: Measurement
    nm: float
    """One of the measured wavelengths."""
    true_colour: bool
    stepped: bool
    """Whether the bins are those of Klems's patches."""
    moving: bool
    """Whether its incidences lie between measured ones."""

    def read(self, data: Any, order: str) -> Floats:
        """Values (rings, sectors, channels) in the bins: one channel, or linear sRGB."""
        return self._mixed(data["brdf"].sel(order=order).transpose("theta_o", "dphi", "wavelength").values)

    def model(self, model: Model | BRDF, incidence: Incidence) -> Floats:
        """The same of a model."""
        wi, grid = direction(incidence.theta, incidence.phi), self.measurement.detector
        wavelengths = self.measurement.wavelengths if self.true_colour else [self.nm]
        values = predicted(model, wi, grid, np.asarray(wavelengths)).value.reshape(*grid.shape, -1)
        return values @ self.weights.T if self.true_colour else values

    def _mixed(self, values: Floats) -> Floats:
        if self.true_colour:
            return values @ self.weights.T
        return values[..., self.measurement.wavelengths == self.nm]

    @property
    def weights(self) -> Floats:
        """From the measured channels to linear sRGB, (3, W)."""
        basis, wavelengths = str(self.measurement.attributes.get("basis", "spectrum")), self.measurement.wavelengths
        if basis == "RGB":
            return np.eye(3)
        if basis == "XYZ":
            return np.asarray(np.linalg.inv(xyz_of_rgb()))
        if basis == "Y" or len(wavelengths) < 3:
            raise ValueError(
                f"true colour needs three wavelengths or more, and this measurement has {len(wavelengths)}: "
                "draw it without true_colour"
            )
        return rgb_weights(wavelengths)

    def shell(self, data: Any, brdf: Floats, opacity: float = SOLID) -> Shell:
        """The lobe of values in the bins (rings, sectors, channels)."""
        light = patches.scattered(data, brdf)
        if not self.true_colour:
            return Shell(light[..., 0], opacity=opacity)
        luminance = light @ xyz_of_rgb()[1]
        area = data["projected_solid_angle"].values
        albedo = float(np.nansum(area[..., None] * brdf, axis=(0, 1)) @ xyz_of_rgb()[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            colours = encoded(np.nan_to_num(light / luminance[..., None], posinf=0.0, neginf=0.0) * min(albedo, 1.0))
        return Shell(np.maximum(luminance, 0.0), paint=colours, opacity=opacity)


def _views(
    subject: _Subject, models: Sequence[Model | BRDF], style: LobeStyle, angles: tuple[float | None, float | None]
) -> tuple[list[View], str]:
    """The panels, and words about the choice of incidences."""
    if models:
        chosen, choice = choose_incidences(subject.measurement, 3, *angles)
        return [view for incidence in chosen for view in _beside(subject, incidence, models)], choice
    chosen, choice = choose_incidences(subject.measurement, 1000 if subject.moving else PANELS, *angles)
    if style.orders:
        return [_nested(subject, incidence) for incidence in chosen], choice
    if not style.overlaid:
        return [
            View(incidence.words, [incidence], [subject.shell(incidence.data, subject.read(incidence.data, "all"))])
            for incidence in chosen
        ], choice
    same = [incidence for incidence in chosen if incidence.phi == chosen[0].phi]
    shells = [subject.shell(each.data, subject.read(each.data, "all"), VEILED) for each in same]
    polar = ", ".join(f"{incidence.theta:g}°" for incidence in same)
    words = f"$\\theta_i$ = {polar}, $\\phi_i$ = {same[0].phi:g}°"
    return [View(words, same, shells)], choice


def _nested(subject: _Subject, incidence: Incidence) -> View:
    """The lobes of 1, 2 and more hits within that of all light."""
    names = [str(order) for order in incidence.data["order"].values]
    legend = {hits(order): ORDERS.get(order, MORE) for order in names}
    shells = [
        replace(
            subject.shell(incidence.data, subject.read(incidence.data, order)),
            paint=ORDERS.get(order, MORE),
            opacity=CLEAR if order == "all" else VEILED,
        )
        for order in names
    ]
    return View(incidence.words, [incidence], shells, legend)


def _beside(subject: _Subject, incidence: Incidence, models: Sequence[Model | BRDF]) -> list[View]:
    """What was measured, the models, and how the only one of them differs."""
    order = _common_order(subject.measurement, models)
    data, measured = incidence.data, subject.read(incidence.data, order)
    told = f", {hits(order)}" if counts(data) else ""
    views = [View(f"measured{told}\n{incidence.words}", [incidence], [subject.shell(data, measured)])]
    for model in models:
        shell = subject.shell(data, subject.model(model, incidence))
        views.append(View(f"{names_of([model])[0]}\n{incidence.words}", [incidence], [shell]))
    if len(models) == 1 and not subject.true_colour:
        theirs, ours = views[1].shells[0].value, views[0].shells[0].value
        shell = Shell(ours, paint=_difference(ours, theirs))
        views.append(View(f"measured, by difference\n{incidence.words}", [incidence], [shell], differs=True))
    return views


def _difference(ours: Floats, theirs: Floats) -> Floats:
    """Colours (rows, columns, 3) of model / measured - 1."""
    from matplotlib import colormaps

    with np.errstate(invalid="ignore", divide="ignore"):
        percent = np.nan_to_num(100 * (theirs / ours - 1), nan=0.0, posinf=PERCENT)
    return np.asarray(colormaps[DIFFERENCES](0.5 + percent / (2 * PERCENT))[..., :3])


def _common_order(measurement: Measurement, models: Sequence[Model | BRDF]) -> str:
    """The order of scattering that all models describe, if it was measured by itself."""
    described = {model.order for model in models}
    known = set(map(str, measurement.dataset["order"].values))
    return described.pop() if len(described) == 1 and described <= known else "all"


def _words(subject: _Subject, views: Sequence[View], scale: Scale, ground: Ground | None) -> tuple[str, ...]:
    """What the caption says, but for the choice of incidences."""
    told = "true colour under D65, luminance" if subject.true_colour else channel_words(subject.measurement, subject.nm)
    holes = any(np.isnan(shell.value).any() for view in views for shell in view.shells)
    return (
        told,
        scale.words,
        f"averaged over {patches.width(views[0].incidences[0].data):.2g}° patches",
        "steps: Klems's patches" if subject.stepped else "",
        "holes: nothing is known" if holes else "",
        "interpolated between measured incidences" if subject.moving else "",
        "" if ground is None else ground.words,
    )
