"""An experiment: surface, material, instrument and seed in one TOML file, told in sentences when wrong, and run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self

import tomli_w
from pydantic import Field, TypeAdapter, ValidationError, field_validator, model_validator

from gonio.goniometer import Goniometer, Progress
from gonio.html_drawing import plane_of_incidence
from gonio.measurement import Measurement
from gonio.models.specimen import Specimen, model_class
from gonio.optics import Conductor, Dielectric, Material, index_table
from gonio.self_check import check
from gonio.tally import MAX_PATHS
from gonio.toml_files import InputError, kind_first, override_value, read_toml, resolve_paths
from gonio.transport.scene import Scene
from microsurfaces import HeightField, Mesh, Surface
from microsurfaces.html_card import html_card
from microsurfaces.recipe import recipe, sentences
from microsurfaces.seeds import derived_seed


@recipe
class Experiment:
    """Everything that decides the numbers of a measurement; with the same package versions, to the last bit.

    Realisation k of the surface is built and measured with seeds derived from (`seed`, k) alone, so that a longer
    series begins with the shorter one; only the slopes of V-grooves are stratified over all of them. One realisation
    speaks of that specimen only; several speak of the ensemble of surfaces, with both noises in the standard errors.
    """

    surface: Surface
    """The relief: a table [surface] with its kind."""
    material: Material
    """What the surface is made of: a table [material] with its kind."""
    goniometer: Goniometer = Goniometer()
    """The instrument: a table [goniometer]."""
    title: str = ""
    """One line for people."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Decides every random number, of surfaces and light."""
    realisations: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """How many different specimens of the surface are measured; `paths` is for each of them."""
    models: tuple[str, ...] | None = None
    """Closed-form models to compare with, their roughness measured from the facets; if left out, those that fit."""

    @field_validator("models")
    @classmethod
    def _known_models(cls, names: tuple[str, ...] | None) -> tuple[str, ...] | None:
        for name in names or ():
            model_class(name)
        return names

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        if isinstance(self.material, Conductor | Dielectric):
            if self.material.name is not None:
                index_table(self.material.name)  # a page that cannot be looked up is no matter of wavelengths
            try:
                self.material.refractive_index(self.goniometer.wavelengths)
            except ValueError as error:
                raise ValueError(f"goniometer.wavelengths: {error}") from None
        if self.realisations * self.goniometer.paths > MAX_PATHS:
            raise ValueError(
                f"realisations = {self.realisations}: with goniometer.paths = {self.goniometer.paths} these are more "
                f"than the {MAX_PATHS} paths an incidence that can be summed exactly; lower one of them"
            )
        for name in self.models or ():
            try:
                Specimen({"beckmann_alpha": 1.0}, self.material, self.surface).described(name)
            except ValueError as error:
                raise ValueError(f"models = {list(self.models or ())}: {error}") from None
        return self

    @classmethod
    def read(cls, path: str | Path, overrides: Iterable[str] = ()) -> Self:
        """The experiment of a TOML file, with `overrides` such as "surface.alpha=0.2" put in.

        Files that the experiment names are looked for beside the TOML file. Raises `InputError` with one sentence for
        each mistake.
        """
        path = Path(path)
        table = read_toml(path, "an experiment needs at least the tables [surface] and [material]")
        if "sweep" in table:
            raise InputError(f"{path} is a campaign: gonio campaign run {path}")
        mistakes = [sentence for override in overrides for sentence in override_value(table, override)]
        resolve_paths(table, path.absolute().parent)
        try:
            experiment = TypeAdapter(cls).validate_json(json.dumps(table, default=str))
        except ValidationError as error:
            mistakes += sentences(error, cls)
        if mistakes:
            raise InputError(*mistakes)
        return experiment

    def _repr_html_(self) -> str:
        """What a notebook shows: the sources, and what will be measured."""
        sources = self.goniometer.theta_i
        count = len(sources) * len(self.goniometer.phi_i)
        paths = self.realisations * self.goniometer.paths
        rows = {
            "surface": self.surface,
            "material": self.material,
            "light": f"{count} incidence{'s' * (count > 1)}, {len(self.goniometer.wavelengths)} wavelengths",
            "detector": self.goniometer.detector,
            "paths": f"{paths:,} an incidence, of {self.realisations} specimen{'s' * (self.realisations > 1)}",
            "seed": self.seed,
        }
        return html_card(self.title or "Experiment", rows, plane_of_incidence(sources))

    def to_dict(self) -> dict[str, Any]:
        """The experiment as plain tables, every default written out; `kind` first, and only where there is a choice."""
        table = TypeAdapter(type(self)).dump_python(self, mode="json", exclude_none=True)
        del table["kind"], table["goniometer"]["kind"]
        scalars = {key: value for key, value in table.items() if not isinstance(value, dict)}
        return scalars | {key: kind_first(value) for key, value in table.items() if isinstance(value, dict)}

    def write(self, path: str | Path) -> None:
        """Write the resolved experiment as TOML; run again it gives the same numbers to the last bit."""
        Path(path).write_text(tomli_w.dumps(self.to_dict()), encoding="utf-8")

    def relief(self, realisation: int = 0) -> HeightField | Mesh:
        """Specimen number `realisation` of the surface. Raises `InputError` if it cannot be built."""
        try:
            return self.surface.build(self.seed, realisation, self.realisations)
        except (ValueError, OSError) as error:
            raise InputError(f"surface: {error}") from error

    def scene(self, realisation: int = 0) -> Scene:
        """Specimen number `realisation`, ready to be measured. Raises `InputError` if it cannot be."""
        relief = self.relief(realisation)
        try:
            return Scene(relief, self.material)
        except ValueError as error:
            raise InputError(f"surface: {error}") from error

    def run(self, threads: int | None = None, progress: Progress | None = None) -> Measurement:
        """Build, measure and merge all realisations.

        Ctrl-C keeps what has been measured, whole realisations and incidences, and marks it `interrupted`. With a
        `target_error` every realisation takes as many replicates as the first one needed. Raises `InputError` for a
        surface that cannot be built, MemoryError for a result that cannot fit.
        """
        merged: Measurement | None = None
        replicates = None
        whole = _Whole(progress, self.realisations)
        for k in range(self.realisations):
            try:
                part = self.goniometer.measure(self.scene(k), self.light_seed(k), threads, whole, replicates)
            except KeyboardInterrupt:
                if merged is None:
                    raise
                return self.described(merged, interrupted=True)
            except ValueError as error:
                raise error if isinstance(error, InputError) else InputError(f"goniometer.{error}") from None
            merged = part if merged is None else merged.merge(part)
            if part.interrupted:
                break
            if self.goniometer.target_error is not None:
                replicates = merged.counted["replicates"].values.ravel().tolist()
            whole.next()
        assert merged is not None
        return self.described(merged, merged.interrupted)

    def described(self, measurement: Measurement, interrupted: bool) -> Measurement:
        """The measurement with its provenance (this experiment, what made it) and its self-check report."""
        provenance = {
            "title": self.title or measurement.attributes["title"],
            "experiment": json.dumps(self.to_dict()),
            "seed": str(self.seed),
            "instruction_set": instruction_set(),
            "interrupted": int(interrupted),
        }
        described = replace(measurement, attributes=measurement.attributes | provenance)
        report = {"self_check": check(described).to_json()}
        return replace(described, attributes=described.attributes | report)

    def light_seed(self, realisation: int = 0) -> int:
        """The seed of the light that falls on specimen number `realisation`."""
        return derived_seed(self.seed, "light", realisation)


@dataclass
class _Whole:
    """Turns the progress of one realisation into that of all."""

    report: Progress | None
    realisations: int
    finished: int = 0
    rays_before: int = 0
    rays: int = 0

    def __call__(self, done: int, total: int, rays: int) -> None:
        self.rays = self.rays_before + rays
        if self.report is not None:
            self.report(self.finished * total + done, self.realisations * total, self.rays)

    def next(self) -> None:
        """The next realisation begins."""
        self.finished += 1
        self.rays_before = self.rays


def instruction_set() -> str:
    """The processor that kernels are compiled for: the same versions give the same bits on the same one."""
    from llvmlite import binding

    return str(binding.get_host_cpu_name())
