"""Spheres and plates: what the measured surface and models of it look like, side by side under the same light."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio import appearance
from gonio.plots.style import INK, PathLike, finished, headline, hits, names_of, new_figure
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gonio.brdf import BRDF
    from gonio.measurement import Measurement
    from gonio.models import Model

ABREAST = 4
"""At most so many spheres stand side by side, the measured one first."""
PLATE = (0.42, 1.0)
"""Height and width of the plate, in spheres."""
GRAZING = 70.0
"""Degrees from the normal to the source behind the plate."""


def sphere(
    measurement: Measurement, path: PathLike | None = None, *, models: Sequence[Model | BRDF] = (), size: int = 440
) -> Figure:
    """Draw spheres with the measured BRDF and with `models`, each above a level plate of the same; a figure.

    It is also written into `path`. All have the same light and the same exposure, and the figure tells both. A sphere
    is `size` pixels wide. Colours are those of daylight (D65) in sRGB. What the noise of a measurement would make
    sparkle is averaged over patches, whose radius is told. Models that have no values in single directions are left out
    and named. Raises ValueError for a measurement without a hemisphere of bins, or whose BRDF at other azimuths phi_i
    is not known.
    """
    smooth, radius = appearance.softened(measurement)
    pictures = [("measured, all orders", *_shaded(smooth, None, size))]
    # The spectrum's nodes make colours: models have the same.
    nodes = measurement.wavelengths if measurement.attributes.get("basis", "spectrum") == "spectrum" else None
    missing = []
    for model in models[: ABREAST - 1]:
        (name,) = names_of([model])
        try:
            pictures.append((f"{name}, {hits(model.order)}", *_shaded(model, nodes, size)))
        except ValueError:
            missing.append(name)
    white = appearance.exposure(*(ball for _, ball, _ in pictures))
    # The source behind the plates is as bright as the measured one's glow needs.
    irradiance = white / max(float(np.quantile(pictures[0][2], 0.99)), 1e-12)
    figure = new_figure(3.3 * len(pictures) + (1.7 if len(pictures) == 1 else 0.4), 5.75)
    panels = figure.subplots(2, len(pictures), squeeze=False, height_ratios=(1.0, PLATE[0]))
    alpha = np.rint(255 * appearance.silhouette(size))
    for (name, ball, plate), (above, below) in zip(pictures, panels.T, strict=True):
        _show(above, np.dstack([appearance.exposed(ball, white=white)[0][..., :3], alpha]))
        _show(below, appearance.exposed(irradiance * plate, white=white)[0])
        above.set_title(name, fontsize=11, color=INK)
    noise = f"measured lobes are averaged within {radius:g}° against noise" if radius else ""
    headline(figure, measurement, "as they look in daylight, one exposure for all", noise)
    words = [*_light(white, irradiance), *_left_out(missing, len(models) - (ABREAST - 1))]
    lines = textwrap.wrap(" ".join(words), int(13.5 * figure.get_figwidth()))
    figure.supxlabel("\n".join(lines), fontsize=8.5, color="#6b6b68")
    return finished(figure, path)


def _shaded(source: Measurement | Model | BRDF, wavelengths: Floats | None, size: int) -> tuple[Floats, Floats]:
    """Radiances of the sphere, and of the plate under a source of irradiance 1."""
    lobes = appearance.coloured(source, wavelengths)
    extent = round(PLATE[0] * size), round(PLATE[1] * size)
    return appearance.sphere(lobes, size), appearance.plate(lobes, extent, GRAZING, irradiance=1.0)


def _show(panel: Axes, picture: NDArray[np.generic]) -> None:
    """Put a picture (rows, columns, 4) of 0 to 255 on `panel`, with nothing around it."""
    panel.imshow(picture.astype(np.uint8), interpolation="antialiased")
    panel.set_axis_off()


def _light(white: float, irradiance: float) -> list[str]:
    """What shines, and how it is exposed."""
    return [
        f"Above: a sphere under a clear sky and a source of irradiance {appearance.IRRADIANCE:g} from the upper left.",
        f"Below: a level plate seen at 20° to 80° from its normal, against a source at {GRAZING:g}° behind it, of "
        f"irradiance {irradiance:.2g}.",
        f"White is radiance {white:.2g}; the sky has up to 1.",
    ]


def _left_out(missing: Sequence[str], more: int) -> list[str]:
    """Which models are not shown, and why."""
    words = [f"Left out, for it has no values in single directions: {name}." for name in missing]
    return [*words, f"{more} more models are not shown."] if more > 0 else words
