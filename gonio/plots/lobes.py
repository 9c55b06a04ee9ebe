"""BRDF in three dimensions: scattered light as a surface around the sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gonio.brdf import BRDF
from gonio.colour import encoded, rgb_weights, xyz_of_rgb
from gonio.detectors import HemisphereGrid, Klems
from gonio.plots import lobe_files, patches, style
from gonio.plots.lobe_scene import Ground, Scale, Shell, View, draw, open_window, window_axes
from gonio.plots.style import (
    COLOURS,
    DIFFERENCES,
    MARKERS,
    MORE,
    ORDERS,
    PERCENT,
    Incidence,
    PathLike,
    channel_words,
    choose_incidences,
    colour_bar,
    counts,
    has_hemisphere,
    headline,
    hits,
    layout,
    nearest_wavelength,
    new_figure,
)
from gonio.sphere import direction
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gonio.measurement import Measurement
    from gonio.models import Model
    from microsurfaces import HeightField

FRAMES = 24
"""Pictures of an animation, from the lowest to the highest measured theta_i and back."""
FRAME_GRID = HemisphereGrid(theta_step=2.0, phi_step=4.0)
"""Bins between measured incidences; half a patch wide at most."""
WINDOWS = 3
"""At most so many lobes stand side by side in a window."""
CLEAR, VEILED, SOLID = 0.22, 0.55, 1.0
"""Opacities: of the light of all orders around its parts, of lobes in one another, and of a lobe by itself."""


def lobes(
    measurement: Measurement,
    path: PathLike,
    wavelength: float | None = None,
    *,
    models: Sequence[Model] = (),
    radius: Literal["linear", "log"] | None = None,
    orders: bool = False,
    overlaid: bool = False,
    true_colour: bool = False,
    ground: HeightField | None = None,
    show: bool = False,
) -> Path:
    """Draw the lobes, BRDF times cos(theta_o), as surfaces in space, one panel an incidence, and return the path.

    The radius in a direction is the light scattered into it: (1/sr), averaged over patches of about 3 degrees with
    the solid angle as weight. Radius and colour have one scale for all panels. `radius` is logarithmic over three
    decades, if not told, where a lobe is so narrow, or the panels so different, that a linear one would show a needle
    or nothing; the figure says which. `wavelength` (nm; the nearest measured one) is 550 nm unless told. Where nothing
    is known a lobe has a hole.

    `models` stand beside what was measured, at the order of scattering that they describe; of a single one the relative
    difference is shown as well, in the colours of the measured lobe. `orders` nests translucent lobes of 1, 2 and more
    hits in that of all light, `overlaid` those of all incidences of one azimuth. `true_colour` colours a spectrum as
    the eye sees it under D65, each direction as bright as the albedo; the radius is then luminance. `ground` is a
    relief to draw, true to scale and hugely enlarged, as the plane under the lobe.

    The suffix chooses the file: .png and the like are rendered by VTK, or by matplotlib where no GL library is
    installed; .svg and .pdf hold true vectors; .gif and .mp4 move over theta_i, interpolated between measured
    incidences; .gltf, .glb and .vtp are the lobes themselves, for other programs. `show` opens a window besides. Raises
    ValueError for a measurement without a hemisphere of bins and for what cannot go together, RuntimeError where no
    window can be opened.
    """
    path = Path(path)
    style.check_path(path, (*lobe_files.MOVING, *lobe_files.SOLID))
    stepped = isinstance(measurement.detector, Klems)
    measurement = _on_grid(measurement)
    _check(measurement, models, orders, overlaid, true_colour)
    moving = path.suffix.lower() in lobe_files.MOVING
    if moving:
        lobe_files.check_movies(path)
        measurement = _frames(measurement)
    subject = _Subject(measurement, nearest_wavelength(measurement, wavelength), true_colour, stepped, moving)
    views, choice = _views(subject, models, orders, overlaid, every=moving)
    scale = Scale.of([shell.value for view in views for shell in view.shells], radius)
    plane = None if ground is None else Ground.of(ground)
    words = (*_words(subject, views, scale, plane), choice)
    if path.suffix.lower() in lobe_files.SOLID:
        lobe_files.save_solids(views, scale, path)
    elif moving:
        lobe_files.save_movie((_figure(measurement, [view], scale, plane, words, path) for view in views), path)
    else:
        style.save(_figure(measurement, views, scale, plane, words, path), path)
    if show:
        open_window(views[:WINDOWS], scale, plane)
    return path


def _figure(
    measurement: Measurement,
    views: Sequence[View],
    scale: Scale,
    ground: Ground | None,
    words: Sequence[str],
    path: Path,
) -> Figure:
    """Panels, colour bars and the caption."""
    rows, columns = _panels(views)
    figure = new_figure(max(4.4 * columns + 0.9, 6.4), 3.25 * rows + 0.95)
    panels = figure.subplots(rows, columns, squeeze=False)
    for panel, view in zip(panels.flat, views, strict=False):
        draw(panel, view, scale, ground, vector=path.suffix.lower() in lobe_files.VECTORS)
    for panel in panels.flat:
        window_axes(panel)
    for norm, label, colours in _bars(views, scale):
        colour_bar(figure, panels, norm, label, colours)
    headline(figure, measurement, *words)
    if views[0].legend:
        figure.legend(handles=_legend(views[0]), loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    return figure


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


def _check(measurement: Measurement, models: Sequence[Model], orders: bool, overlaid: bool, true_colour: bool) -> None:
    """Raise ValueError for what cannot be drawn."""
    if not has_hemisphere(measurement):
        raise ValueError(
            "lobes need a hemisphere of bins, and this measurement was made with Apertures; "
            "draw slices, or measure with detector = HemisphereGrid"
        )
    if sum((bool(models), orders, overlaid)) > 1:
        raise ValueError("lobes show one at a time: models, orders or overlaid incidences; draw several pictures")
    if orders and (true_colour or len(measurement.dataset["order"]) < 2):
        raise ValueError(
            "orders have colours of their own, not the true ones: draw two pictures"
            if true_colour
            else "this measurement does not tell the orders of scattering apart: draw it without orders"
        )
    if len(models) > len(MARKERS) // 2:
        raise ValueError(f"{len(models)} models are too many beside one another: name {len(MARKERS) // 2} at most")


def _on_grid(measurement: Measurement) -> Measurement:
    """Klems's patches as a hemisphere of bins, each with the value of its patch."""
    if not isinstance(measurement.detector, Klems):
        return measurement
    chosen, _ = choose_incidences(measurement)
    theta, phi = [incidence.theta for incidence in chosen], [chosen[0].phi]
    return BRDF.of(measurement).sampled(theta, phi, HemisphereGrid(theta_step=2.5, phi_step=5.0), nodes=1)


def _frames(measurement: Measurement) -> Measurement:
    """Incidences of an animation, from the lowest to the highest measured theta_i at the first azimuth."""
    chosen, _ = choose_incidences(measurement, panels=1000)
    phi = chosen[0].phi
    theta = [incidence.theta for incidence in chosen if incidence.phi == phi]
    if len(theta) < 2:
        raise ValueError(
            "a moving picture needs two measured theta_i at least, and this measurement has one: draw .png"
        )
    between = np.unique(np.linspace(min(theta), max(theta), FRAMES).round())
    return BRDF.of(measurement).sampled(between, [phi], FRAME_GRID)


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

    def model(self, model: Model, incidence: Incidence) -> Floats:
        """The same of a model."""
        wi, grid = direction(incidence.theta, incidence.phi), self.measurement.detector
        wavelengths = self.measurement.wavelengths if self.true_colour else [self.nm]
        values = model.average(wi, grid, wavelengths).reshape(*grid.shape, -1)
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
    subject: _Subject, models: Sequence[Model], orders: bool, overlaid: bool, every: bool
) -> tuple[list[View], str]:
    """The panels, and words about the choice of incidences."""
    if models:
        chosen, choice = choose_incidences(subject.measurement, 3)
        return [view for incidence in chosen for view in _beside(subject, incidence, models)], choice
    chosen, choice = choose_incidences(subject.measurement, 1000 if every else style.PANELS)
    if orders:
        return [_nested(subject, incidence) for incidence in chosen], choice
    if not overlaid:
        return [
            View(incidence.words, [incidence], [subject.shell(incidence.data, subject.read(incidence.data, "all"))])
            for incidence in chosen
        ], choice
    same = [incidence for incidence in chosen if incidence.phi == chosen[0].phi]
    shells = [subject.shell(each.data, subject.read(each.data, "all"), VEILED) for each in same]
    angles = ", ".join(f"{incidence.theta:g}°" for incidence in same)
    words = f"$\\theta_i$ = {angles}, $\\phi_i$ = {same[0].phi:g}°"
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


def _beside(subject: _Subject, incidence: Incidence, models: Sequence[Model]) -> list[View]:
    """What was measured, the models, and how the only one of them differs."""
    order = _common_order(subject.measurement, models)
    data, measured = incidence.data, subject.read(incidence.data, order)
    told = f", {hits(order)}" if counts(data) else ""
    views = [View(f"measured{told}\n{incidence.words}", [incidence], [subject.shell(data, measured)])]
    for model in models:
        shell = subject.shell(data, subject.model(model, incidence))
        views.append(View(f"{type(model).__name__}\n{incidence.words}", [incidence], [shell]))
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


def _common_order(measurement: Measurement, models: Sequence[Model]) -> str:
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
