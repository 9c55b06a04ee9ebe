"""`gonio plot | report | render`: measurements to look at."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from gonio.cli.terminal import (
    FILE_SUFFIXES,
    Flag,
    Models,
    Numbers,
    Output,
    RunError,
    Words,
    app,
    complain,
    load_measurement,
    make_room,
    make_writable,
    open_window,
    telling_mistakes,
    telling_refusals,
    working,
)
from gonio.toml_files import InputError

if TYPE_CHECKING:
    from gonio.experiment import Experiment
    from gonio.measurement import Measurement
    from gonio.models import Model
    from microsurfaces import HeightField


KINDS = {
    "lobes": "lobes",
    "slice": "slices",
    "hemisphere": "hemisphere",
    "albedo": "albedo",
    "difference": "difference",
    "sphere": "sphere",
    "surface": "relief",
    "paths": "paths",
}
"""What `gonio plot` draws, and the functions of `plots` that do."""

UNASKED = ("lobes", "slice", "hemisphere", "albedo")
"""What it draws if no kind is asked for."""

OF_SURFACES = {"surface", "paths"}
"""Kinds that show a surface, not a measurement."""

KIND_OPTIONS = {
    "lobes": ("wavelength", "radius", "orders", "overlaid", "true_colour", "ground", "show"),
    "hemisphere": ("wavelength",),
    "difference": ("wavelength",),
    "surface": ("show",),
    "paths": ("theta_i",),
}
"""Options of `gonio plot` that only some kinds have."""

ONE_EACH = {"wavelength": "nm", "theta_i": "deg"}
"""Options that may have several values, a picture for each, and their units in the names of files."""


@Parameter(name="*")
@dataclass(frozen=True)
class LobeOptions:
    """How lobes are drawn."""

    log: Annotated[bool | None, Parameter(negative="--linear", show_default=False)] = None
    """Draw lobes with a logarithmic or a linear radius; what suits them if not given."""
    orders: Flag = False
    """Nest lobes of 1, 2 and more hits."""
    overlaid: Flag = False
    """Put the lobes of all incidences into one another."""
    true_colour: Flag = False
    """Colour lobes as the eye sees them."""
    ground: Flag = False
    """Draw the microsurface under the lobes."""


@Parameter(name="*")
@dataclass(frozen=True)
class Places:
    """Where pictures are shown and written."""

    show: Flag = False
    """Open a window, too, with the lobes or the surface."""
    to: Annotated[Path | None, Parameter()] = None
    """File of a single picture: .png .svg .pdf; lobes moving as .gif .mp4, for other programs as .gltf .glb .vtp."""
    output: Output = None
    """Folder for the pictures, all .png; the measurement's own if not given."""


@app.command
def plot(
    file: Path,
    /,
    *,
    kind: Words = (),
    models: Models = (),
    wavelength: Numbers = (),
    theta_i: Numbers = (),
    style: LobeOptions = LobeOptions(),
    places: Places = Places(),
) -> None:
    """Draw a measurement: lobes.png, slices.png, hemisphere.png and albedo.png, or the kinds that are asked for.

    Kinds of pictures, with --kind:

      lobes       scattered light as surfaces in space
      slice       the BRDF in the plane of incidence, with error bars and models
      hemisphere  maps of the BRDF and of its errors, seen from above
      albedo      all the light that is reflected, against the incident angle
      difference  where models are above or below what was measured
      sphere      what the material looks like, beside models
      surface     the microsurface and its statistics
      paths       light on a section of the microsurface

    Parameters
    ----------
    file
        The measurement: a .nc file, or another program's file; an experiment's .toml file for surface and paths.
    kind
        What to draw, as often as needed; lobes, slice, hemisphere and albedo if not given.
    models
        A model, as often as needed; if not given, those that describe the specimen, but none beside lobes.
    wavelength
        Of lobes, maps and differences, one or several, nm, a picture each; the one nearest to 550 if not given.
    theta_i
        Incident angle for paths, one or several, degrees, a picture each; 45 if not given.
    """
    kinds = tuple(dict.fromkeys(map(_kind, kind)))
    given = {
        "wavelength": tuple(dict.fromkeys(wavelength)),
        "theta_i": tuple(dict.fromkeys(theta_i)),
        "radius": None if style.log is None else "log" if style.log else "linear",
        "orders": style.orders,
        "overlaid": style.overlaid,
        "true_colour": style.true_colour,
        "ground": style.ground,
        "show": places.show,
    }
    options = {name: value for name, value in given.items() if value}
    _check_options(kinds or UNASKED, options)
    pictures = list(_pictures(file, kinds, models, options))
    for name, path, draw in _placed(pictures, places, file.parent):
        _draw_one(name, path, draw, bool(kinds))


def _kind(name: str) -> str:
    """A kind of picture; `InputError` with the nearest one for anything else."""
    from microsurfaces.recipe import did_you_mean

    if name in KINDS:
        return name
    raise InputError(
        f"--kind {name}: there is no such picture{did_you_mean(name, KINDS) or '; choose ' + ', '.join(KINDS)}"
    )


def _check_options(kinds: Sequence[str], options: Mapping[str, Any]) -> None:
    """Raise `InputError` for an option that none of the kinds has."""
    flags = {"radius": "--log or --linear"}
    for name in options:
        having = [kind for kind, names in KIND_OPTIONS.items() if name in names]
        if not set(having) & set(kinds):
            flag = flags.get(name, f"--{name.replace('_', '-')}")
            raise InputError(f"{flag} means nothing here: add --kind {' or --kind '.join(having)}.")


def _pictures(
    file: Path, kinds: Sequence[str], models: Sequence[str], options: Mapping[str, Any]
) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The names of the pictures, and functions that draw them into a path."""
    from gonio.models.specimen import models_for

    wanted = set(kinds or UNASKED)
    experiment = _experiment_behind(file) if "ground" in options or wanted & OF_SURFACES else None
    measurement = load_measurement(file) if wanted - OF_SURFACES else None
    chosen = () if measurement is None else models_for(measurement, models or None)
    if experiment is not None and "ground" in options:
        options = {**options, "ground": _height_field(experiment)}
    for kind in kinds or UNASKED:
        if kind in OF_SURFACES:
            assert experiment is not None
            yield from _of_surface(kind, experiment, options)
        elif kind == "difference":
            assert measurement is not None
            yield from _differences(measurement, chosen, options)
        else:
            assert measurement is not None
            yield from _of_measurement(kind, measurement, chosen if models or kind != "lobes" else (), options)


def _variants(kind: str, options: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What the file of each picture of a kind ends with, and its options: a picture a wavelength or angle."""
    own = {name: value for name, value in options.items() if name in KIND_OPTIONS.get(kind, ())}
    for name in ONE_EACH.keys() & own.keys():
        values = own.pop(name)
        for value in values:
            yield f"-{value:g}{ONE_EACH[name]}" if len(values) > 1 else "", {**own, name: value}
        return
    yield "", own


def _of_surface(
    kind: str, experiment: Experiment, options: Mapping[str, Any]
) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Pictures of the surface of an experiment; a window is opened if that is among the options."""
    from gonio import plots

    for ending, extra in _variants(kind, options):
        if extra.pop("show", False):
            open_window(experiment.relief())
        draw = getattr(plots, KINDS[kind])
        yield f"{kind}{ending}", partial(draw, experiment.surface, seed=experiment.seed, **extra)


def _of_measurement(
    kind: str, measurement: Measurement, models: Sequence[Model], options: Mapping[str, Any]
) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Pictures of a measurement, with models where its kind shows them."""
    from gonio import plots

    for ending, extra in _variants(kind, options):
        draw: Callable[..., Any] = _draw_lobes if kind == "lobes" else getattr(plots, KINDS[kind])
        shown = {} if kind == "hemisphere" else {"models": models}
        yield f"{KINDS[kind]}{ending}", partial(draw, measurement, **shown, **extra)


def _draw_lobes(
    measurement: Measurement,
    path: Path,
    models: Sequence[Model],
    wavelength: float | None = None,
    show: bool = False,
    **look: Any,
) -> None:
    """A picture, a film or meshes of lobes, as the suffix tells, and a window if `show`."""
    from gonio import plots
    from gonio.plots.lobe_files import FILMS, MESHES

    style, suffix = plots.LobeStyle(**look), path.suffix.lower()
    options: dict[str, Any] = {"wavelength": wavelength, "style": style}
    if suffix in FILMS:
        if models:
            raise ValueError("a film shows what was measured alone: leave out --model")
        plots.lobe_film(measurement, path, **options)
    else:
        draw = plots.lobe_meshes if suffix in MESHES else plots.lobes
        draw(measurement, path, models=models, **options)
    if show:
        plots.show_lobes(measurement, models=models, **options)


def _differences(
    measurement: Measurement, models: Sequence[Model], options: Mapping[str, Any]
) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Pictures of every model's difference from a measurement; each model is compared when it is first drawn."""
    from gonio import plots
    from gonio.comparison import compare

    if not models:
        raise InputError(
            "No model describes this specimen by itself; name one with --model, such as "
            '--model "cook-torrance m=0.3 material.name=Au".'
        )
    compared = cache(partial(compare, measurement))

    def draw(path: Path, model: Model, extra: Mapping[str, Any]) -> None:
        plots.difference(measurement, compared(model), path, **extra)

    names = [type(model).__name__ for model in models]
    for number, (model, name) in enumerate(zip(models, names, strict=True), 1):
        stem = "difference" if len(models) == 1 else f"difference-{name}"
        stem = stem if names.count(name) == 1 else f"{stem}-{number}"
        for ending, extra in _variants("difference", options):
            yield f"{stem}{ending}", partial(draw, model=model, extra=extra)


def _placed(
    pictures: Sequence[tuple[str, Callable[..., Any]]], places: Places, home: Path
) -> Iterator[tuple[str, Path, Callable[..., Any]]]:
    """Pictures with the files that they go into: a single one, or .png files in a folder, which is made."""
    if places.to is not None:
        if places.output is not None:
            raise InputError("--to is the file of a single picture, --output the folder of several: give one of them.")
        if len(pictures) > 1:
            raise InputError(
                f"--to {places.to}: takes a single picture, and these are {', '.join(name for name, _ in pictures)}; "
                "choose a single one, or give a folder with --output."
            )
        make_room(places.to)
        yield pictures[0][0], places.to, pictures[0][1]
        return
    folder = places.output or home
    if folder.suffix.lower() in FILE_SUFFIXES and not folder.exists():
        raise InputError(f"--output {folder}: must be a folder; the file of a single picture is given with --to.")
    make_writable(folder)
    for name, draw in pictures:
        yield name, folder / f"{name}.png", draw


def _draw_one(name: str, path: Path, draw: Callable[..., Any], asked: bool) -> None:
    """Draw and tell the file; what cannot be drawn is an error only if it was asked for."""
    try:
        with telling_refusals(path), working(f"drawing {path}"):
            draw(path)
    except ValueError as error:
        if asked:
            raise InputError(f"{name}: {error}.") from None
        complain(0, f"No {path.name}: {error}")
    except RuntimeError as error:
        raise RunError(f"No window: {error}") from None
    else:
        print(path)


def _experiment_behind(file: Path) -> Experiment:
    """The experiment in a .toml file, or the one that a measurement was made with."""
    from pydantic import TypeAdapter, ValidationError

    from gonio.experiment import Experiment

    if file.suffix.lower() == ".toml":
        return Experiment.read(file)
    try:
        return TypeAdapter(Experiment).validate_json(load_measurement(file).attributes["experiment"])
    except (KeyError, ValidationError):
        raise InputError(
            f"{file}: its surface has no recipe, which only a measurement by gonio run has; give an experiment's .toml."
        ) from None


def _height_field(experiment: Experiment) -> HeightField:
    """The relief to draw under a lobe; `InputError` for a surface that is none."""
    from microsurfaces import HeightField

    relief = experiment.relief()
    if not isinstance(relief, HeightField):
        raise InputError("--ground: the surface is a mesh, not a height field; leave it out, or draw --kind surface.")
    return relief


@app.command
def report(file: Path, /, *, models: Models = (), to: Path | None = None) -> None:
    """Make one HTML page of a measurement, to look at, to print and to send.

    It holds a summary in words, pictures, a lobe that turns with the mouse,
    tables, the comparison with models, the self-checks and the experiment, and
    works offline from disk.

    Parameters
    ----------
    file
        The measurement: a .nc file, or another program's file that gonio reads.
    models
        A model, as often as needed, as for gonio compare; those that describe the specimen if not given.
    to
        The page, an .html file; report.html beside the measurement if not given.
    """
    from gonio.models.specimen import models_for
    from gonio.reporting import report as write

    measurement, page = load_measurement(file), to or file.parent / "report.html"
    if page.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--to {page}: a report is a page; give a name that ends with .html.")
    chosen = models_for(measurement, models or None)
    make_room(page)
    command = ["gonio", "report", file.name, *(word for name in models for word in ("--model", name))]
    with telling_mistakes(), telling_refusals(page), working(f"writing {page}"):
        print(write(measurement, page, chosen, command=shlex.join(command)))


@app.command
def render(
    file: Path,
    /,
    *,
    to: Path,
    scene: str = "sphere",
    size: int = 512,
    spp: int = 256,
    seed: int = 0,
    isotropic: Flag = False,
) -> None:
    """Path-trace a scene made of a measured surface, with Mitsuba 3 (pip install mitsuba).

    A distant source and a clear sky shine on it, with all interreflections.
    gonio plot --kind sphere draws a sphere without Mitsuba.

    Parameters
    ----------
    file
        The measurement: a .nc file, another program's file that gonio reads, or a .bsdf file of RGL's, taken as it is.
    to
        The picture: .png, exposed for a screen, or .exr, radiances in linear sRGB.
    scene
        sphere or cylinder on a floor, or ball, a sphere alone seen from afar.
    size
        Width and height in pixels.
    spp
        Paths per pixel.
    seed
        Seed of the paths.
    isotropic
        Declare that the surface looks the same from every incident azimuth.
    """
    from gonio.rendering import render as rendered

    make_room(to)
    try:
        with telling_mistakes(), telling_refusals(to), working(f"rendering {to}"):
            print(rendered(file, to, scene=scene, size=size, spp=spp, seed=seed, isotropic=isotropic))
    except RuntimeError as error:
        raise RunError(str(error)) from None
