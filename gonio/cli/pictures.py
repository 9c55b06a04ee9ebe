"""`gonio plot | report | render`: measurements to look at."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from gonio.cli.terminal import (
    Flag,
    ModelNames,
    Output,
    RunError,
    app,
    complain,
    load_measurement,
    make_writable,
    open_window,
    telling_mistakes,
    telling_refusals,
    working,
)

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


PICTURE_SUFFIXES = (".png", ".svg", ".pdf", ".jpg", ".gif", ".mp4", ".gltf", ".glb", ".vtp")
"""What no folder's name ends with."""


@app.command
def plot(
    file: Path,
    /,
    *,
    kind: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = (),
    models: ModelNames = (),
    wavelength: float | None = None,
    log: Annotated[bool | None, Parameter(negative="--linear", show_default=False)] = None,
    orders: Flag = False,
    overlaid: Flag = False,
    true_colour: Flag = False,
    ground: Flag = False,
    theta_i: float | None = None,
    show: Flag = False,
    output: Output = None,
) -> None:
    """Draw a measurement: lobes.png, slices.png, hemisphere.png and albedo.png, or the kinds that are asked for.

      lobes       scattered light as surfaces in space
      slice       the BRDF in the plane of incidence, with error bars and models
      hemisphere  maps of the BRDF and of its errors, seen from above
      albedo      all the light that is sent back, against the angle of incidence
      difference  where models are above or below what was measured
      sphere      what the material looks like, beside models
      surface     the microsurface and its statistics
      paths       light on a section of the microsurface

    Parameters
    ----------
    file
        The measurement: a .nc file, or a foreign file that gonio reads; of an experiment, a .toml file, surface and
        paths are drawn.
    kind
        What to draw, as often as needed.
    models
        A model, as often as needed, as for gonio compare; lobes have those beside them that are named here.
    wavelength
        Of lobes, maps and differences, nm; the measured one nearest to 550 if not given.
    log
        Draw lobes with a logarithmic or a linear radius; what suits them if not given.
    orders
        Nest lobes of 1, 2 and more hits.
    overlaid
        Put the lobes of all incidences into one another.
    true_colour
        Colour lobes as the eye sees them.
    ground
        Draw the microsurface under the lobes.
    theta_i
        Angle of incidence for paths, degrees; 45 if not given.
    show
        Open a window, too, with the lobes or the surface.
    output
        Folder for the pictures; the measurement's own if not given. For a single kind also a file: .png .svg .pdf;
        lobes moving as .gif .mp4, or for other programs as .gltf .glb .vtp.
    """
    kinds = tuple(dict.fromkeys(map(_kind, kind)))
    given = {
        "wavelength": wavelength,
        "radius": None if log is None else "log" if log else "linear",
        "orders": orders,
        "overlaid": overlaid,
        "true_colour": true_colour,
        "ground": ground,
        "theta_i": theta_i,
        "show": show,
    }
    options = {name: value for name, value in given.items() if value not in (None, False)}
    _check_options(kinds or UNASKED, options)
    pictures = list(_pictures(file, kinds, models, options))
    for name, path, draw in _placed(pictures, output, file.parent, bool(kinds)):
        _draw_one(name, path, draw, bool(kinds))


def _kind(name: str) -> str:
    """A kind of picture; `InputError` with the nearest one for anything else."""
    from gonio.toml_files import InputError
    from microsurfaces.recipe import did_you_mean

    if name in KINDS:
        return name
    raise InputError(
        f"--kind {name}: there is no such picture{did_you_mean(name, KINDS) or '; choose ' + ', '.join(KINDS)}"
    )


def _check_options(kinds: Sequence[str], options: Mapping[str, Any]) -> None:
    """Raise `InputError` for an option that none of the kinds has."""
    from gonio.toml_files import InputError

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
    from gonio import plots
    from gonio.models.specimen import models_for

    wanted = set(kinds or UNASKED)
    experiment = _experiment_behind(file) if "ground" in options or wanted & OF_SURFACES else None
    measurement = load_measurement(file) if wanted - OF_SURFACES else None
    chosen = () if measurement is None else models_for(measurement, models or None)
    for kind in kinds or UNASKED:
        draw = getattr(plots, KINDS[kind])
        extra = {name: value for name, value in options.items() if name in KIND_OPTIONS.get(kind, ())}
        if kind in OF_SURFACES:
            assert experiment is not None
            if extra.pop("show", False):
                open_window(experiment.relief())
            yield kind, partial(draw, experiment.surface, seed=experiment.seed, **extra)
            continue
        assert measurement is not None
        if kind == "difference":
            yield from _differences(measurement, chosen, partial(draw, **extra))
        elif kind == "hemisphere":
            yield kind, partial(draw, measurement, **extra)
        elif kind == "lobes":
            if experiment is not None and "ground" in extra:
                extra["ground"] = _height_field(experiment)
            yield kind, partial(_draw_lobes, measurement, models=chosen if models else (), **extra)
        else:
            yield KINDS[kind], partial(draw, measurement, models=chosen, **extra)


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
    measurement: Measurement, models: Sequence[Model], draw: Callable[..., Any]
) -> Iterator[tuple[str, Callable[..., Any]]]:
    """One picture a model."""
    from gonio.comparison import compare
    from gonio.toml_files import InputError

    if not models:
        raise InputError(
            "No model describes this specimen by itself; name one with --model, such as "
            '--model "cook-torrance m=0.3 material.name=Au".'
        )
    names = [type(model).__name__ for model in models]
    for number, (model, name) in enumerate(zip(models, names, strict=True), 1):
        stem = "difference" if len(models) == 1 else f"difference-{name}"
        stem = stem if names.count(name) == 1 else f"{stem}-{number}"
        yield stem, lambda path, model=model: draw(measurement, compare(measurement, model), path)


def _placed(
    pictures: Sequence[tuple[str, Callable[..., Any]]], output: Path | None, home: Path, asked: bool
) -> Iterator[tuple[str, Path, Callable[..., Any]]]:
    """Pictures with the files that they go into: one file, or .png files in a folder, which is made."""
    from gonio.toml_files import InputError

    file = output is not None and bool(output.suffix) and not output.is_dir()
    if output is not None and file and asked and len(pictures) == 1:
        make_writable(output.parent)
        yield pictures[0][0], output, pictures[0][1]
        return
    if output is not None and output.suffix.lower() in PICTURE_SUFFIXES and not output.is_dir():
        raise InputError(f"{output}: {len(pictures)} pictures need a folder; choose a single one with --kind.")
    folder = output or home
    make_writable(folder)
    for name, draw in pictures:
        yield name, folder / f"{name}.png", draw


def _draw_one(name: str, path: Path, draw: Callable[..., Any], asked: bool) -> None:
    """Draw and tell the file; what cannot be drawn is an error only if it was asked for."""
    from gonio.toml_files import InputError

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
    from gonio.toml_files import InputError

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
    from gonio.toml_files import InputError
    from microsurfaces import HeightField

    relief = experiment.relief()
    if not isinstance(relief, HeightField):
        raise InputError("--ground: the surface is a mesh, not a height field; leave it out, or draw --kind surface.")
    return relief


@app.command
def report(file: Path, /, *, models: ModelNames = (), output: Output = None) -> None:
    """Make one HTML page of a measurement, to look at, to print and to send.

    It holds a summary in words, pictures, a lobe that turns with the mouse,
    tables, the comparison with models, the self-checks and the experiment, and
    works offline from disk.

    Parameters
    ----------
    file
        The measurement: a .nc file, or a foreign file that gonio reads.
    models
        A model, as often as needed, as for gonio compare; those that fit the material if not given.
    output
        The page; report.html beside the measurement if not given.
    """
    from gonio.models.specimen import models_for
    from gonio.reporting import report as write
    from gonio.toml_files import InputError

    measurement, page = load_measurement(file), output or file.parent / "report.html"
    if page.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{page}: a report is a page; give a name that ends with .html.")
    chosen = models_for(measurement, models or None)
    make_writable(page.parent)
    command = ["gonio", "report", file.name, *(word for name in models for word in ("--model", name))]
    with telling_mistakes(), telling_refusals(page), working(f"writing {page}"):
        print(write(measurement, page, chosen, command=shlex.join(command)))


@app.command
def render(
    file: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    scene: str = "sphere",
    size: int = 512,
    spp: int = 256,
    seed: int = 0,
    isotropic: Annotated[bool, Parameter(negative="", show_default=False)] = False,
) -> None:
    """Path-trace a scene made of a measured surface, with Mitsuba 3 (pip install mitsuba).

    A distant source and a clear sky shine on it; light is reflected as often as it
    likes. gonio plot draws a sphere without Mitsuba.

    Parameters
    ----------
    file
        The measurement: a .nc file, a foreign file that gonio reads, or a .bsdf file of RGL's, taken as it is.
    output
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
        Declare that the surface looks the same from every azimuth of the light.
    """
    from gonio.rendering import render as rendered

    make_writable(output.parent)
    try:
        with telling_mistakes(), telling_refusals(output), working(f"rendering {output}"):
            print(rendered(file, output, scene=scene, size=size, spp=spp, seed=seed, isotropic=isotropic))
    except RuntimeError as error:
        raise RunError(str(error)) from None
