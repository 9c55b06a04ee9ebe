"""The models of a specimen: by name, with settings in place of what was measured on it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w
from pydantic import TypeAdapter, ValidationError

from gonio.detectors import Klems
from gonio.models import Model, matching
from gonio.models.parameters import BOUNDS, give_way, put, whole_name
from gonio.optics import DIELECTRICS, Lambertian, Material
from gonio.toml_files import InputError, from_toml, kind_first, read_toml
from microsurfaces.atomic_write import atomic_write
from microsurfaces.recipe import did_you_mean, members, parameters, sentences

if TYPE_CHECKING:
    from gonio.measurement import Measurement

_CHOICES = {"masking": "SmithCorrelated", "distribution": "Beckmann"}
"""Parts that a model has where nothing else is said."""

_SETTING = re.compile(r"[\s,:]+(?=[A-Za-z_][\w.]*\s*=)")
"""What stands before a setting, as in "cook-torrance m=0.3, k_d=0.1"."""


@dataclass(frozen=True)
class Specimen:
    """What is known of a surface that was measured; it supplies the parameters that are not given."""

    statistics: Mapping[str, float | None]
    """What `Statistics` measured on its facets."""
    material: Material | None
    """None if it is not known: then it must be said, as in "cook-torrance m=0.3 material.name=Au"."""
    surface: object = None
    """Its recipe, if known."""

    def described(self, text: str, to_fit: bool = False) -> Model:
        """The model of a text such as "CookTorrance", "cook-torrance m=0.3 k_d=0.1", "microfacet masking.kind=VCavity".

        Names may be written with hyphens and in any case, parameters of a part without its name where only one part has
        them, and kinds without the word: "microfacet distribution=GGX alpha=0.3 name=Au". What is not said is the
        specimen's: its material, and roughness as measured on its facets. A model `to_fit` needs no more than a start:
        what the specimen does not tell is put into the middle between the limits. Raises ValueError in one sentence for
        each mistake.
        """
        name, *settings = _SETTING.split(text.strip())
        pairs = (setting.partition("=") for setting in settings)
        return self.model(name, {key.strip(): from_toml(value.strip()) for key, _, value in pairs}, to_fit)

    def model(self, name: str, settings: Mapping[str, Any], to_fit: bool = False) -> Model:
        """The model called `name` with `settings`, by dotted names or in nested tables; else as `described`."""
        cls: Any = model_class(name)
        settings = dict(_flat(settings))
        table = self._table(cls, bool(settings) or to_fit, to_fit)
        try:
            settings = {whole_name(table, key, value): value for key, value in settings.items()}
            for key, value in settings.items():
                put(table, key, value)
            give_way(table, settings)
            for part in _materials(cls):
                if self.material is None and part not in table:
                    raise ValueError(_untold(cls, [f"{part}.name"]))
                if isinstance(made_of := table.get(part), dict) and "kind" not in made_of:
                    made_of["kind"] = _kind_of(made_of)
            model: Model = TypeAdapter(Model).validate_json(json.dumps(table))
        except KeyError as error:
            raise ValueError(f"{error.args[0]} is a value, not a table.") from None
        except ValidationError as error:
            raise ValueError(_in_words(error, Model)) from None
        return model

    def _table(self, cls: Any, more: bool, to_fit: bool) -> dict[str, Any]:
        """What the specimen tells of a model; a ValueError if it tells too little and there is no `more` to come."""
        if self.material is None:
            if not more:
                raise ValueError(_untold(cls, [*cls.free, *(f"{part}.name" for part in _materials(cls))]))
            return self._unspecified(cls, to_fit)
        try:
            return _as_table(cls.of(self.statistics, self.material, self.surface))
        except ValueError as error:
            if not more:
                raise ValueError(_in_words(error, cls)) from None
            return self._unspecified(cls, to_fit)

    def _unspecified(self, cls: Any, to_fit: bool) -> dict[str, Any]:
        """The table of a model of which the specimen tells no more than its material."""
        table: dict[str, Any] = {"kind": cls.__name__}
        for name in parameters(cls):
            if name in _CHOICES:
                table[name] = {"kind": _CHOICES[name]}
            elif self.material is None:
                continue
            elif name == "local" or (name == "material" and not isinstance(self.material, Lambertian)):
                table[name] = TypeAdapter(Material).dump_python(self.material, mode="json", exclude_none=True)
        for name, (low, high) in cls.free.items() if to_fit else ():
            put(table, name, float(np.sqrt(low * high)) if low > 0.0 else (low + high) / 4.0)
        return table


def model_class(text: str) -> type:
    """The class of the model that a text names, whatever its settings; ValueError for an unknown name."""
    name = _SETTING.split(text.strip())[0]
    known = {_plain(kind): cls for kind, cls in members(Model).items()}
    if _plain(name) not in known:
        names = members(Model)
        raise ValueError(f"there is no such model; choose from {', '.join(names)}{did_you_mean(name, names)}")
    return known[_plain(name)]


def is_model(text: str) -> bool:
    """Whether a text begins with a model's name."""
    try:
        model_class(text)
    except ValueError:
        return False
    return True


def _plain(name: str) -> str:
    return re.sub(r"[-_\s]", "", name).lower()


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names and values of nested tables, whole numbers as the numbers that models have; kinds come first."""
    for key, value in sorted(settings.items(), key=lambda item: not item[0].endswith("kind")):
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            number = key.rsplit(".", 1)[-1] in BOUNDS and isinstance(value, int)
            yield f"{prefix}{key}", float(value) if number else value


def _materials(cls: Any) -> list[str]:
    """The parameters of a model that say what its specimen is made of."""
    return [name for name in ("material", "local") if name in parameters(cls)]


def _untold(cls: Any, names: Sequence[str]) -> str:
    """The sentence that asks for parameters which nothing else tells."""
    middles = {name: float(f"{np.sqrt(low * high) or high / 4.0:.2g}") for name, (low, high) in cls.free.items()}
    wanted = " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)
    example = " ".join(f"{name}={middles[name]:g}" if name in middles else f"{name}=Au" for name in names)
    what = "it" if len(names) == 1 else "them"
    return f"nothing tells {wanted} of the specimen: give {what}, such as {example}."


def _kind_of(material: Mapping[str, Any]) -> str:
    """The kind of a material of which only the parameters were given."""
    if "reflectance" in material:
        return "Lambertian"
    transparent = material.get("name") in DIELECTRICS or ("eta" in material and "k" not in material)
    return "Dielectric" if transparent else "Conductor"


def _as_table(model: Model) -> dict[str, Any]:
    table: dict[str, Any] = TypeAdapter(Model).dump_python(model, mode="json", exclude_none=True)
    return table


def _in_words(error: ValueError, expected: Any) -> str:
    return " ".join(sentences(error, expected)) if isinstance(error, ValidationError) else str(error)


def models_for(measurement: Measurement, names: Iterable[str] | None = None, to_fit: bool = False) -> tuple[Model, ...]:
    """The models that `names` describe, or those that fit, with the measured specimen's own roughness and material.

    A name may have settings, "cook-torrance m=0.3 k_d=0.1", or be a TOML file with tables [[model]] that have a `kind`
    and settings. What is not said is the specimen's; `to_fit` fills in what it does not tell, too. An external
    measurement does not tell roughness and material, and no model speaks of light from Klems's patches: none fits by
    itself. Raises `InputError` with a sentence for each name that is none, or that cannot describe the specimen.
    """
    specimen = Specimen(measurement.surface_statistics, measurement.material, measurement.surface)
    if names is None:
        if specimen.material is None or isinstance(measurement.detector, Klems):
            return ()
        return matching(specimen.statistics, specimen.material, specimen.surface)
    return models_named(names, specimen, to_fit)


def models_named(
    names: Iterable[str], specimen: Specimen = Specimen({}, None), to_fit: bool = False
) -> tuple[Model, ...]:
    """As `models_for`, of a `specimen`; if it is left out everything must be said."""
    models: list[Model] = []
    mistakes: list[str] = []
    for name in names:
        try:
            models += (
                _models_of_file(Path(name), specimen, to_fit)
                if name.endswith(".toml")
                else [specimen.described(name, to_fit)]
            )
        except InputError as error:
            mistakes += error.sentences
        except ValueError as error:
            mistakes.append(f"{name}: {error}")
    if mistakes:
        raise InputError(*mistakes)
    return tuple(models)


def _models_of_file(path: Path, specimen: Specimen, to_fit: bool) -> list[Model]:
    """The models of a TOML file's tables [[model]]; `InputError` in a sentence for each mistake."""
    tables = read_toml(path, "it needs tables [[model]] with a kind").get("model")
    tables = [tables] if isinstance(tables, dict) else tables
    if not isinstance(tables, list) or not all(isinstance(table, dict) and "kind" in table for table in tables):
        raise InputError(f'{path}: has no tables [[model]] with a kind, such as [[model]] kind = "CookTorrance".')
    models, mistakes = [], []
    for number, table in enumerate(tables, 1):
        kind = str(table["kind"])
        try:
            models.append(specimen.model(kind, {k: v for k, v in table.items() if k != "kind"}, to_fit))
        except ValueError as error:
            mistakes.append(f"{path}, model {number}, {kind}: {error}")
    if mistakes:
        raise InputError(*mistakes)
    return models


def write_models(models: Iterable[Model], path: str | Path) -> Path:
    """Write models as tables [[model]] of a TOML file, which `models_for` reads."""
    tables = [TypeAdapter(type(model)).dump_python(model, mode="json", exclude_none=True) for model in models]
    with atomic_write(Path(path)) as temporary:
        temporary.write_text(tomli_w.dumps({"model": [kind_first(table) for table in tables]}), encoding="utf-8")
    return Path(path)
