"""A measurement and its models as one page that can be sent: words, pictures, tables, lobes that turn with the mouse.

The page works from disk, needs no network and asks for none, and can be printed.
"""

from __future__ import annotations

import base64
import functools
import inspect
import io
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

from gonio import __version__, plots, tables
from gonio.comparison import Comparison, compare
from gonio.fitting import rank
from gonio.optics import Conductor, Dielectric, citation
from gonio.reporting.explore import explored
from gonio.reporting.markup import clean, data, page, paragraphs, script, table, tag
from gonio.reporting.words import best, errors, summary
from gonio.self_check import SelfCheckReport, check
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gonio.brdf import BRDF
    from gonio.fitting import Fit
    from gonio.measurement import Measurement
    from gonio.models import Model

__all__ = ["report"]

POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
"""What a browser may do for the page: run what is in it, and fetch nothing."""


def report(
    measurement: Measurement,
    path: str | Path,
    models: Sequence[Model | BRDF | Comparison] = (),
    fits: Sequence[Fit] = (),
    command: str = "",
    pictures: Iterable[Path] = (),
) -> Path:
    """Write a measurement, its comparison with `models` and the `fits` as one HTML page, and return its path.

    What exists already is not made again: a model that was compared may stand there as its comparison, and `pictures`
    are files called lobes.png, slices.png, hemisphere.png, albedo.png, difference.png or fits.png, which go into the
    page as they are. `command` is what made the page, for those who want to make it again. What a measurement does not
    have (an external one keeps no orders, apertures have no lobes) is left out with a sentence. Raises ValueError if
    nothing was measured, and if plotly is not installed.
    """
    path = Path(path)
    library = script(_plotly(), id="plotly", type="text/plain")
    if not measurement.measured.any():
        raise ValueError("no incidence of this measurement was measured: nothing to report")
    comparisons, complaints = _compared(measurement, models)
    self_check = _self_check(measurement)
    shown = [model.model if isinstance(model, Comparison) else model for model in models]
    picture = functools.partial(_picture, {drawn.stem: drawn for drawn in pictures})
    sections = (
        _section("Summary", *paragraphs(*summary(measurement, comparisons, self_check))),
        _explore(measurement),
        _section("Pictures", *_pictures(measurement, shown, best(comparisons), picture)),
        _section("Albedo and energy", *_energy(measurement)),
        _section("Models", *_comparison(comparisons, complaints)),
        *([_section("Fits", *_fitted(measurement, fits, picture))] if fits else []),
        _section("Self-checks", *_checks(self_check)),
        _section("The experiment", *_experiment(measurement)),
        _section("Where it comes from", *_provenance(measurement, shown, command)),
    )
    content = data("data", explored(measurement, comparisons))
    text = page(_document(_title(measurement), sections, [library, content, script(_part("explore.js"))]))
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def _plotly() -> str:
    """The source of plotly.js."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise ValueError("the report is made with plotly, which is not installed: pip install gonio[report]") from None
    return str(get_plotlyjs())


def _part(name: str) -> str:
    return resources.files("gonio.reporting").joinpath(name).read_text(encoding="utf-8")


def _title(measurement: Measurement) -> str:
    return str(measurement.attributes.get("title") or "A measured BRDF")


def _document(title: str, sections: Sequence[Element], scripts: Sequence[Element]) -> Element:
    """The page; scripts last, so that the text is there before the library has been read."""
    style = tag("style")
    style.text = _part("style.css")
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="generator", content=f"gonio {__version__}"),
        tag("title", title),
        style,
    )
    links = [tag("a", str(part[0].text), href=f"#{part.get('id')}") for part in sections]
    header = tag(
        "header",
        tag("p", "A report by gonio, the virtual gonioreflectometer", class_="note"),
        tag("h1", title),
        tag("nav", *links, aria_label="Sections"),
    )
    return tag("html", head, tag("body", header, tag("main", *sections), *scripts), lang="en")


def _section(heading: str, *content: Element) -> Element:
    name = heading.lower().replace(" ", "-")
    return tag("section", tag("h2", heading), *content, id=name)


# --- Looking around ---------------------------------------------------------------------------------------------------


def _explore(measurement: Measurement) -> Element:
    """The place of the interactive lobe and slice, which the page's script fills."""
    controls = (
        _control("incidence", "Incident direction", tag("input", type="range", id="incidence", min="0", value="0")),
        _control("channel", "Wavelength or channel", tag("select", id="channel")),
        _control("order", "Light that hit the surface", tag("select", id="order")),
        _control(
            "radius",
            "Radius of the lobe",
            tag(
                "select",
                tag("option", "linear", value="linear"),
                tag("option", "logarithmic, 3 decades", value="logarithmic"),
                id="radius",
            ),
        ),
    )
    places = [tag("div", id="slice", class_="plot", role="img", aria_label="The slice")]
    words = "The BRDF in the plane of incidence, with two standard errors where errors are known. "
    if "dphi" in measurement.dataset.dims:
        places.insert(0, tag("div", id="lobe", class_="plot", role="img", aria_label="The lobe in space"))
        words = f"BRDF times cos theta_o as a radius, averaged over patches; drag it to turn it. {words}"
    else:
        words = f"The detector has no regular grid of bins, so there is no lobe to turn. {words}"
    return _section(
        "Look around",
        tag("form", *controls, class_="controls"),
        tag("p", "", id="shown", class_="note", aria_live="polite"),
        tag("div", *places, class_="pair"),
        tag("p", "", id="models-note", class_="note"),
        tag("noscript", tag("p", "Here are plots to look at from all sides, for browsers with scripts.")),
        tag("p", f"{words}Numbers here have four digits; all of them are in the measurement's file.", class_="note"),
    )


def _control(name: str, words: str, element: Element) -> Element:
    return tag("div", tag("label", words, for_=name), element, tag("output", "", id=f"{name}-value", for_=name))


# --- Pictures ---------------------------------------------------------------------------------------------------------


Draw = Callable[[], "Figure"]
"""Draws a figure of `plots`."""
Picture = Callable[[str, Draw, str], Element]
"""A figure in the page, by its name, how it is drawn, and its caption."""


def _pictures(
    measurement: Measurement, models: Sequence[Model | BRDF], chosen: Comparison | None, picture: Picture
) -> list[Element]:
    """The figures of `plots`; a sentence in place of one that this measurement does not allow."""
    draw: dict[str, tuple[Draw, str]] = {
        "lobes": (
            functools.partial(plots.lobes, measurement),
            "Lobes: the radius in a direction is the light sent into it, per steradian.",
        ),
        "slices": (
            functools.partial(plots.slices, measurement, models=models),
            "Slices: the BRDF in the plane of incidence with two standard errors, and the models as markers.",
        ),
        "hemisphere": (
            functools.partial(plots.hemisphere, measurement),
            "The hemisphere from above: the BRDF, and its relative standard error where it is known.",
        ),
        "albedo": (
            functools.partial(plots.albedo, measurement, models=models),
            "Albedo: the share of the light that comes back against the angle of incidence, and the models as markers.",
        ),
    }
    if chosen is not None:
        draw["difference"] = (
            functools.partial(plots.difference, measurement, chosen),
            f"{tables.name_of(chosen.model)} against the measurement: where it is too bright and where too dark.",
        )
    return [picture(name, *how) for name, how in draw.items()]


def _picture(drawn: Mapping[str, Path], name: str, draw: Draw, caption: str) -> Element:
    from PIL import Image

    try:
        content = drawn[name].read_bytes() if name in drawn else _drawing(draw)
    except ValueError as error:
        return tag("p", f"No picture of the {name}: {error}.")
    width, height = Image.open(io.BytesIO(content)).size
    picture = tag(
        "img",
        src=f"data:image/png;base64,{base64.b64encode(content).decode()}",
        alt=caption,
        width=str(width),
        height=str(height),
        decoding="async",
    )
    return tag("figure", picture, tag("figcaption", caption))


def _drawing(draw: Draw) -> bytes:
    content = io.BytesIO()
    draw().savefig(content, format="png")
    return content.getvalue()


# --- Numbers ----------------------------------------------------------------------------------------------------------


def _energy(measurement: Measurement) -> list[Element]:
    parts = [table(tables.albedo(measurement), "Albedo, the share of the light that comes back, ± standard error")]
    orders = tables.energy(measurement)
    if orders is None:
        return [*parts, *paragraphs("The file keeps no orders of scattering and no energy budget.")]
    return [*parts, table(orders, "Orders of scattering in the reflected light, and what did not come back")]


def _compared(
    measurement: Measurement, models: Sequence[Model | BRDF | Comparison]
) -> tuple[list[Comparison], list[str]]:
    """How each model compares, and a sentence for each that cannot be compared."""
    comparisons, complaints = [], []
    for model in models:
        if isinstance(model, Comparison):
            comparisons.append(model)
            continue
        try:
            comparisons.append(compare(measurement, model))
        except ValueError as error:
            complaints.append(f"{tables.name_of(model)} was not compared: {error}")
    return comparisons, complaints


def _comparison(comparisons: Sequence[Comparison], complaints: Sequence[str]) -> list[Element]:
    """The models side by side, then each of them, then the bins in which the best one fails."""
    chosen = best(comparisons)
    if chosen is None:
        return paragraphs("No model was compared." if not complaints else "", *complaints)
    parts = paragraphs(*dict.fromkeys(line for comparison in comparisons for line in comparison.preamble()))
    if len(comparisons) > 1:
        parts.append(table(tables.ranking(comparisons), "All models, the best lobe first"))
    for comparison in comparisons:
        name = tables.name_of(comparison.model)
        parts += [
            tag("h3", name),
            tag("p", f"Comparison: {comparison.conclusion()}"),
            table(tables.comparison(comparison), f"{name} against {tables.light(comparison.order)}"),
        ]
    worst = tables.worst_bins(chosen)
    if worst is not None:
        name = tables.name_of(chosen.model)
        parts.append(table(worst, f"{name}: the bins that add most to L1, beyond doubt (3 standard errors)"))
    note = (
        "Of every incidence the wavelength whose albedo differs most; in brackets the standard error of the last "
        "digits. L1: how far the lobes differ, and how far noise alone would make them. Consistent: with noise; "
        "significant: beyond noise; inconclusive: specimens that move the whole lobe could explain it; unknown: "
        "without errors."
    )
    return [*parts, tag("p", note, class_="note"), *paragraphs(*complaints)]


def _fitted(measurement: Measurement, fits: Sequence[Fit], picture: Picture) -> list[Element]:
    caption = "Fits: what was measured and the fitted models, their residuals, and the parameters' 95 % intervals."
    parts = [picture("fits", functools.partial(plots.fits, measurement, fits), caption)]
    for found in fits:
        name = tables.name_of(found.model)
        parts += [tag("h3", name), table(tables.parameters(found), f"Fitted to {tables.light(found.order)}")]
        correlations = tables.correlations(found)
        parts += [] if correlations is None else [table(correlations, "Correlations")]
        parts += paragraphs(*found.remarks())
    for order in dict.fromkeys(found.order for found in fits):
        alike = [found for found in fits if found.order == order]
        if len(alike) > 1:
            parts.append(table(tables.ranked(rank(alike)), f"Models of {tables.light(order)}, the best first"))
    return parts


def _self_check(measurement: Measurement) -> SelfCheckReport | None:
    """The one that goes with the measurement, or a new one; None where there is nothing to check."""
    if measurement.sums is None:
        return None
    kept = measurement.attributes.get("self_check")
    return check(measurement) if kept is None else SelfCheckReport.from_json(kept)


def _checks(self_check: SelfCheckReport | None) -> list[Element]:
    if self_check is None:
        return paragraphs("The measurement is external, without the sums that self-checks are made of.")
    return [tag("p", self_check.summary()[0]), table(tables.checks(self_check), "Every self-check and what it found")]


# --- Provenance -------------------------------------------------------------------------------------------------------


def _experiment(measurement: Measurement) -> list[Element]:
    """The experiment as TOML, also as a file to save; what is known of it if there is none."""
    import tomli_w

    known = _told(measurement.attributes, "experiment")
    if not known:
        parts = {name: _told(measurement.attributes, name) for name in ("material", "goniometer", "detector")}
        text = tomli_w.dumps({name: _without_none(part) for name, part in parts.items() if part})
        return [*paragraphs("No experiment file made this measurement. What it tells:"), _code(text)]
    text = tomli_w.dumps(_without_none(known))
    packed = base64.b64encode(clean(text).encode()).decode()
    link = tag("a", "Save as experiment.toml", href=f"data:text/plain;base64,{packed}", download="experiment.toml")
    return [
        *paragraphs("Everything that decides the numbers; run again it gives the same."),
        _code(text),
        tag("p", link),
    ]


def _told(attributes: dict[str, Any], name: str) -> dict[str, Any]:
    """A table that is kept as JSON among the attributes of a measurement; empty if it is not there or damaged."""
    try:
        found = json.loads(attributes[name])
    except (KeyError, TypeError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _without_none(part: dict[str, Any]) -> dict[str, Any]:
    """TOML knows no null."""
    return {
        name: _without_none(value) if isinstance(value, dict) else value
        for name, value in part.items()
        if value is not None
    }


def _code(text: str) -> Element:
    return tag("pre", tag("code", text), tabindex="0")


def _provenance(measurement: Measurement, models: Sequence[Model | BRDF], command: str) -> list[Element]:
    again = [tag("h3", "To run it again"), _code("\n".join(_commands(measurement, command)))]
    return [
        _facts(measurement),
        tag("p", errors(measurement)),
        tag("h3", "To cite it"),
        tag("ul", *(tag("li", source) for source in _sources(measurement, models))),
        *again,
    ]


_NOT_FACTS = (
    "title",
    "experiment",
    "self_check",
    "facets",
    "surface_statistics",
    "goniometer",
    "detector",
    "material",
)
"""Attributes that other parts of the report show, or that are for programs."""


def _facts(measurement: Measurement) -> Element:
    """Seed, versions, platform and whatever else the file says of itself."""
    rows = []
    for name, value in measurement.attributes.items():
        if name in _NOT_FACTS:
            continue
        inner = _told(measurement.attributes, name)
        words = ", ".join(f"{key} {part}" for key, part in inner.items()) if inner else str(value)
        rows.append(tag("tr", tag("th", name.replace("_", " "), scope="row"), tag("td", words)))
    caption = tag("caption", "What the file says of itself")
    return tag("div", tag("table", caption, tag("tbody", *rows), class_="facts"), class_="scroll")


def _sources(measurement: Measurement, models: Sequence[Model | BRDF]) -> list[str]:
    """What to cite: the program, the refractive indices, the models."""
    version = _told(measurement.attributes, "versions").get("gonio", __version__)
    sources = [f"gonio {version}, a virtual gonioreflectometer, with the experiment above."]
    if measurement.sums is None:
        sources = [f"The measurement's own source: {measurement.attributes['origin']}.", f"gonio {__version__}."]
    material = measurement.material
    if isinstance(material, Conductor | Dielectric) and material.name is not None:
        sources.append(f"Refractive indices of {material.name}: {citation(material.name)}.")
    for kind in dict.fromkeys(type(model) for model in models):
        sources += [f"{kind.__name__}. {source}" for source in _literature(inspect.getdoc(kind) or "")]
    return sources


def _literature(page: str) -> list[str]:
    """The paragraphs of a recipe's page that name a DOI."""
    return [" ".join(part.split()) for part in page.split("\n\n") if re.search(r"\bdoi:", part)]


def _commands(measurement: Measurement, command: str) -> list[str]:
    """What to type, from a bare Python on."""
    lines = [f'pip install "gonio[report]=={_told(measurement.attributes, "versions").get("gonio", __version__)}"']
    if _told(measurement.attributes, "experiment"):
        lines.append("gonio run experiment.toml -o results        # the experiment above")
    return [*lines, command] if command else lines
