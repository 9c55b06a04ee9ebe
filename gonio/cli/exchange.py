"""`gonio export | list`: other programs' files, and all that there is to choose from."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.cli.terminal import (
    Flag,
    Numbers,
    app,
    load_measurement,
    make_room,
    say,
    standard_output,
    telling_mistakes,
    telling_refusals,
    working,
)
from gonio.toml_files import InputError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from gonio.brdf import BRDF
    from gonio.measurement import Measurement


@app.command
def export(
    source: str,
    /,
    *,
    to: Path,
    format: str | None = None,
    isotropic: Flag = False,
    wavelength: Numbers = (),
) -> None:
    """Write a measurement or a model in another program's format, and tell what that cost.

    The file is read back as its usual readers do, and compared with the source on
    the source's own bins. gonio list shows the formats.

    Parameters
    ----------
    source
        A .nc file, another program's file, a model such as "microfacet alpha=0.3 name=Au", or a .toml file of one.
    to
        The file to write; its suffix decides the format.
    format
        A format that decides instead, such as exr-rgb; if not given, the first that has the suffix.
    isotropic
        Declare that the measured surface looks the same from every incident azimuth.
    wavelength
        Wavelengths that a model is written for, nm; 450, 550 and 650 if not given.
    """
    from gonio import formats

    brdf = _source(source, isotropic, wavelength)
    make_room(to)
    with telling_mistakes(), telling_refusals(to):
        with working(f"writing {to}"):
            exported = formats.export(brdf, to, format)
        print(exported.path)
        with working(f"reading {to} back"):
            sentences = (*exported.notes, exported.loss.sentence())
    for sentence in sentences:
        say(sentence)


def _source(text: str, isotropic: bool, wavelengths: Sequence[float]) -> Measurement | BRDF:
    """What is to be exported: the model that `text` describes, or the measurement in the file of that name."""
    from gonio.brdf import BRDF
    from gonio.models.specimen import is_model, models_named

    file = Path(text)
    if file.suffix == ".toml" or (not file.exists() and (is_model(text) or "=" in text)):
        models = models_named([text])
        if len(models) != 1:
            raise InputError(f"{text} has {len(models)} models, and one goes into a file: leave the others out.")
        if isotropic:
            raise InputError("--isotropic means nothing for a model: it knows every azimuth.")
        with telling_mistakes():
            return BRDF.of(models[0], wavelengths or None)
    if wavelengths:
        raise InputError(f"--wavelength is for models; {file} is written at the wavelengths that were measured.")
    measurement = load_measurement(file)
    return measurement.as_isotropic() if isotropic else measurement


@app.command(name="list")
def list_(name: str | None = None, /) -> None:
    """Show every surface, material, detector, model and file format, with parameters and their defaults.

    Parameters
    ----------
    name
        One of them, shown with its whole description; all in one line each if not given.
    """
    from gonio.formats import FORMATS
    from microsurfaces.recipe import did_you_mean

    catalogue = _catalogue()
    known = {cls.__name__: cls for classes in catalogue.values() for cls in classes}
    if name is None:
        for heading, classes in catalogue.items():
            say(f"{heading}\n", style="bold")
            for cls in classes:
                _describe(cls, (cls.__doc__ or "").partition("\n")[0])
        _list_materials()
        _list_formats()
    elif name in known:
        _describe(known[name], _reflowed(inspect.cleandoc(known[name].__doc__ or "")))
    elif name in FORMATS:
        say(name, style="bold")
        say(f"{FORMATS[name].title} ({FORMATS[name].suffix})\n\n{_reflowed(FORMATS[name].page)}")
    else:
        names = (*known, *FORMATS)
        suggestion = did_you_mean(name, names) or "; gonio list shows all there are"
        raise InputError(f"{name}: there is nothing of that name{suggestion}")


def _catalogue() -> dict[str, list[type]]:
    """Every recipe, under the heading it is listed with."""
    from gonio.detectors import Detector
    from gonio.experiment import Experiment
    from gonio.goniometer import Goniometer
    from gonio.models import Distribution, Masking, Model
    from gonio.optics import Material
    from microsurfaces import Surface
    from microsurfaces.recipe import members

    unions: dict[str, Any] = {
        "Surfaces: [surface]": Surface,
        "Materials: [material]": Material,
        "Detectors: [goniometer.detector]": Detector,
        "Models: models = [...], --model": Model,
        "Slope distributions of models: distribution.kind": Distribution,
        "Masking and shadowing of models: masking.kind": Masking,
        "The experiment, its goniometer": Experiment,
    }
    catalogue = {heading: list(members(union).values()) for heading, union in unions.items()}
    catalogue["The experiment, its goniometer"].append(Goniometer)
    return catalogue


def _describe(cls: type, text: str) -> None:
    """Print a recipe: its description, then a table of parameters, defaults and meanings."""
    from rich.table import Table
    from rich.text import Text

    from microsurfaces.recipe import parameters

    console = standard_output()
    say(cls.__name__, style="bold")
    say(text)
    table = Table.grid(padding=(0, 2, 0, 0))
    for name, field in parameters(cls).items():
        row = (f"  {name}", _default(field), " ".join((field.description or "").split()))
        table.add_row(*map(Text, row))
    console.print(table, "") if table.row_count else console.print()


def _list_formats() -> None:
    """What `gonio export` writes, and gonio reads wherever it reads a measurement."""
    from rich.table import Table
    from rich.text import Text

    from gonio.formats import FORMATS

    say("Formats: gonio export FILE --to NAME.SUFFIX, --format for other than the first of a suffix\n", style="bold")
    table = Table.grid(padding=(0, 2, 0, 0))
    for name, format in FORMATS.items():
        table.add_row(*map(Text, (f"  {name}", format.suffix, format.title)))
    standard_output().print(table)


def _reflowed(text: str) -> str:
    """`text` with one line a paragraph, but for what is set in as formulas are."""
    paragraphs = text.split("\n\n")
    return "\n\n".join(p if p.startswith(" ") else " ".join(p.split("\n")) for p in paragraphs) + "\n"


def _default(field: FieldInfo) -> str:
    """The default of a parameter as TOML has it."""
    from microsurfaces.recipe import as_toml

    if field.is_required():
        return "required"
    value = field.get_default()
    return "-" if value is None else type(value).__name__ if hasattr(value, "kind") else as_toml(value)


def _list_materials() -> None:
    """Print the materials that have a table of refractive indices, with their sources."""
    from rich.table import Table

    from gonio.optics import citation, tabulated_materials

    table = Table.grid(padding=(0, 2, 0, 0))
    for symbol, english in tabulated_materials().items():
        table.add_row(f"  {symbol}", english, citation(symbol))
    say("Materials with a name: Conductor or Dielectric, name = ...\n", style="bold")
    standard_output().print(table)
