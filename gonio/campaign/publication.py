"""A finished campaign as a data set for an archive: files that others find, understand, check and may use."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import json
import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
import xarray as xr

from gonio import __version__
from gonio.campaign.dataset import SINGLE, open_campaign, variable_name
from gonio.campaign.results import Merged, Steps, cell, index_of, merge
from gonio.campaign.store import CampaignStore, keys_of, measurement_file, write_durably
from gonio.netcdf import load, save
from gonio.noise import Noises
from gonio.toml_files import InputError

LICENCES = {
    "CC0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "CC-BY-4.0": "https://creativecommons.org/licenses/by/4.0/",
    "CC-BY-SA-4.0": "https://creativecommons.org/licenses/by-sa/4.0/",
    "CC-BY-NC-4.0": "https://creativecommons.org/licenses/by-nc/4.0/",
    "ODbL-1.0": "https://opendatacommons.org/licenses/odbl/1-0/",
}
"""Licences that suit data, by their SPDX identifiers."""

KEYWORDS = ("BRDF", "reflectance", "surface roughness", "goniophotometry", "ray tracing")

SHOWN = 24
"""At most so many drawings stand in the README."""

LISTED = 8
"""At most so many values of a parameter are written out."""

VARIABLES = (
    "`brdf` is the BRDF, averaged over each bin with the weight of the cosine, and `count` the number of paths that "
    "arrived there; `order` is the number of surface hits, from single scattering (1) on, and their sum (all). "
    "`albedo` is the directional-hemispherical reflectance. The energy budget, `escaped` + `absorbed` + `truncated` + "
    "`lost`, is 1: the light that was launched."
)
"""What the README says of the variables beside their table."""


@dataclass(frozen=True)
class About:
    """What an archive, and whoever uses the data, has to know."""

    title: str
    creators: tuple[str, ...]
    """As "Family, Given"."""
    licence: str
    """An SPDX identifier, such as CC-BY-4.0."""
    description: str = ""
    """A paragraph; what the surfaces are and what they were measured for."""

    @property
    def licence_url(self) -> str:
        """Where the licence is found."""
        return LICENCES.get(self.licence, f"https://spdx.org/licenses/{self.licence}.html")

    def attributes(self) -> dict[str, str]:
        """What every file says of itself, by the Attribute Convention for Data Discovery."""
        known = {
            "Conventions": "CF-1.11, ACDD-1.3",
            "summary": self.description,
            "creator_name": "; ".join(self.creators),
            "license": f"{self.licence}, {self.licence_url}",
            "keywords": ", ".join(KEYWORDS),
            "source": f"gonio {__version__}, a virtual gonioreflectometer",
        }
        return {name: text for name, text in known.items() if text}


def publish(
    folder: str | Path, target: str | Path, about: About, single: bool = False, progress: Steps | None = None
) -> Path:
    """Write the finished campaign in `folder` as a new folder `target`, ready for an archive.

    It holds measurements/*.nc (with `single`, all of them in campaign.nc instead), index.csv, thumbnails/*.svg,
    README.md, datacite.json for the DOI, manifest.json with all that was asked, in inputs/ the height maps that were
    measured, and SHA256SUMS. `gonio.open_campaign(target)` opens it. The folder appears when it is complete.

    Raises `InputError` if the campaign is not finished, if `target` exists, and with `single` if one array cannot hold
    the experiments; OSError where nothing can be written.
    """
    folder, target = Path(folder), Path(target)
    if target.exists():
        raise InputError(f"{target} exists already: give another folder; nothing is written over.")
    merged = merge(folder)
    if merged.incomplete:
        total = merged.incomplete + len(merged.files)
        raise InputError(f"{folder}: {merged.incomplete} of {total} experiments lack units; run the campaign first.")
    with _appearing(target) as scratch:
        _Publication(folder, scratch, about, merged, single, progress or (lambda done, total: None)).write()
    return target


@contextlib.contextmanager
def _appearing(target: Path) -> Iterator[Path]:
    """A folder under a temporary name that becomes `target` in the end, or nothing."""
    scratch = target.with_name(f".{target.name}-{secrets.token_hex(4)}.tmp")
    scratch.mkdir(parents=True)
    try:
        yield scratch
        scratch.rename(target)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@dataclass
class _Publication:
    """The files of one data set while they are written."""

    folder: Path
    target: Path
    about: About
    merged: Merged
    single: bool
    progress: Steps
    manifest: dict[str, Any] = field(init=False)
    """All that was asked, with the height maps where they are in the publication."""

    @property
    def _store(self) -> CampaignStore:
        """The publication, read as a campaign's folder."""
        return CampaignStore(self.target)

    def write(self) -> None:
        """Write everything, the checksums last."""
        original = CampaignStore(self.folder).manifest()
        inputs = _inputs(original)
        self.manifest = _moved(original, inputs) | {"title": self.about.title}
        for path, name in inputs.items():
            (self.target / name).parent.mkdir(exist_ok=True)
            shutil.copyfile(path, self.target / name)
        write_durably(self._store.manifest_file, json.dumps(self.manifest, indent=1).encode())
        (self.target / "thumbnails").mkdir()
        self._store.measurements.mkdir()
        names = [self._measurement(number) for number in range(len(self.manifest["experiments"]))]
        if self.single:
            _write_single(open_campaign(self.target), self.target / SINGLE, self._attributes())
            shutil.rmtree(self._store.measurements)
        write_durably(self.target / "index.csv", self._index(names).encode())
        write_durably(self.target / "datacite.json", json.dumps(_datacite(self.about), indent=1).encode())
        write_durably(self.target / "README.md", self._readme(names).encode())
        write_durably(self.target / "SHA256SUMS", _checksums(self.target).encode())

    def _attributes(self) -> dict[str, str]:
        return {"title": self.about.title, **self.about.attributes(), "versions": json.dumps(self.manifest["versions"])}

    def _measurement(self, number: int) -> str:
        """Write one measurement, with what it says of itself, and its drawing; the name of both, without suffix."""
        entries = self.manifest["experiments"]
        path = self._store.measurements / measurement_file(entries, number)
        told = self.about.attributes() | {"experiment": json.dumps(entries[number]["experiment"])}
        measurement = load(self.merged.files[number])
        # Written anew: HDF5 would keep what an attribute said before, such as where a file was on this machine.
        save(replace(measurement, attributes=measurement.attributes | told), path)
        drawing = measurement.sketch().replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
        write_durably(self.target / "thumbnails" / f"{path.stem}.svg", drawing.encode())
        self.progress(number + 1, len(entries))
        return path.stem

    def _index(self, names: Sequence[str]) -> str:
        """The table of all experiments as CSV."""
        files = [SINGLE if self.single else f"measurements/{name}.nc" for name in names]
        return index_of(self._points, {"file": files, "thumbnail": [f"thumbnails/{name}.svg" for name in names]})

    @property
    def _points(self) -> list[dict[str, Any]]:
        """The swept parameters of every experiment."""
        return [entry["parameters"] for entry in self.manifest["experiments"]]

    # --- The README ---------------------------------------------------------------------------------------------------

    def _readme(self, names: Sequence[str]) -> str:
        about, count = self.about, len(names)
        return "\n\n".join(
            part
            for part in (
                f"# {about.title}",
                about.description,
                f"By {'; '.join(about.creators)}. Licence: [{about.licence}]({about.licence_url}).",
                f"{count} bidirectional reflectance distribution functions (BRDFs) of surfaces that exist in a "
                f"computer only, measured by gonio {__version__}, a virtual gonioreflectometer: light is traced "
                "through the microsurface, reflected as often as it likes, and counted in the bins of a detector. "
                "Every value has a standard error.",
                "## How to cite\n\n"
                f"{'; '.join(about.creators)} ({_year()}). {about.title} [data set]. DOI: (assigned by the archive)",
                f"## What varies\n\n{self._parameters()}",
                f"## How to open it\n\n{self._opening()}",
                f"## What is in the files\n\n{VARIABLES}\n\n{_contents(self._sample(names))}",
                f"## How sure it is\n\n{self._sureness()}",
                f"## How it was measured\n\n{self._method()}",
                "## How to check it\n\n`sha256sum -c SHA256SUMS` checks that all files are what was published.",
                f"## What it looks like\n\n{self._thumbnails(names)}",
            )
            if part
        )

    def _sample(self, names: Sequence[str]) -> xr.Dataset:
        """One data set to tell the variables of; not read but for its labels."""
        path = self.target / (SINGLE if self.single else f"measurements/{names[0]}.nc")
        with xr.open_dataset(path, engine="h5netcdf") as sample:
            return sample

    def _parameters(self) -> str:
        lines = ["| parameter | in Python | values |", "| --- | --- | --- |"]
        for key in keys_of(self._points):
            values = list(dict.fromkeys(cell(point.get(key)) for point in self._points))
            told = ", ".join(values) if len(values) <= LISTED else f"{len(values)}, from {values[0]} to {values[-1]}"
            lines.append(f"| {key} | `{variable_name(key)}` | {told} |")
        return "\n".join(lines) if len(lines) > 2 else "One experiment."

    def _opening(self) -> str:
        one = "campaign.nc" if self.single else f"measurements/{measurement_file(self.manifest['experiments'], 0)}"
        return (
            f"```python\nimport gonio  # pip install gonio=={__version__}\n\n"
            'data = gonio.open_campaign(".")  # an xarray.Dataset of everything, read when values are asked for\n'
            "data.albedo\n```\n\n"
            f'Any netCDF-4 reader opens the files without gonio, for example `xarray.open_dataset("{one}")`. index.csv '
            "lists the experiments, and manifest.json holds each of them whole."
        )

    def _sureness(self) -> str:
        """The noises of the whole, if they can be told apart."""
        found = list(self.merged.noises.values())
        words = (
            "`brdf_standard_error` holds all that is uncertain, `brdf_standard_error_mc` the Monte Carlo part alone; "
            "intervals are t standard errors on either side, with Student's t for `degrees_of_freedom`."
        )
        if not found:
            return f"{words} One specimen of every surface was measured: errors speak of that specimen."
        return f"{words}\n\n" + "\n".join(f"* {line}" for line in Noises.together(found).sentences()[:2])

    def _method(self) -> str:
        first = self.manifest["experiments"][0]["experiment"]
        versions = ", ".join(f"{name} {version}" for name, version in self.manifest["versions"].items())
        return (
            "Directions point away from the surface; angles are in degrees, azimuths from x counter-clockwise, "
            "dphi = phi_o - phi_i (0 on the side of the source, 180 on that of the specular direction); lengths are in "
            "µm, wavelengths in nm. Geometric optics, unpolarised light: no diffraction, no interference. "
            f"Versions: {versions}. Experiment 1, from which the others differ in the parameters above; saved as "
            "experiment.toml it is repeated by `gonio run experiment.toml`:\n\n"
            f"```toml\n{tomli_w.dumps(first)}```"
        )

    def _thumbnails(self, names: Sequence[str]) -> str:
        chosen = np.unique(np.linspace(0, len(names) - 1, min(SHOWN, len(names))).round().astype(int))
        lines = ["| | |", "| --- | --- |"]
        for number in chosen.tolist():
            point = self._points[number]
            words = ", ".join(f"{key} = {cell(value)}" for key, value in point.items()) or f"experiment {number + 1}"
            lines.append(f"| {words} | ![lobes](thumbnails/{names[number]}.svg) |")
        return "Lobes in the plane of incidence; sources orange, specular directions blue.\n\n" + "\n".join(lines)


def _contents(sample: xr.Dataset) -> str:
    lines = ["| variable | dimensions | unit | |", "| --- | --- | --- | --- |"]
    for name, variable in sample.variables.items():
        unit, words = (variable.attrs.get(key, "") for key in ("units", "long_name"))
        lines.append(f"| `{name}` | {', '.join(map(str, variable.dims))} | {unit} | {words} |")
    return "\n".join(lines)


def _year() -> int:
    return datetime.datetime.now(tz=datetime.UTC).year


def _datacite(about: About) -> dict[str, Any]:
    """What a DOI is registered with: the attributes of DataCite's metadata schema 4."""
    return {
        "schemaVersion": "http://datacite.org/schema/kernel-4",
        "titles": [{"title": about.title}],
        "creators": [{"name": name, "nameType": "Personal"} for name in about.creators],
        "publisher": {"name": ":unav"},
        "publicationYear": _year(),
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Virtual BRDF measurements"},
        "subjects": [{"subject": word} for word in KEYWORDS],
        "formats": ["application/x-netcdf", "text/csv"],
        "version": "1.0",
        "rightsList": [
            {
                "rightsIdentifier": about.licence,
                "rightsIdentifierScheme": "SPDX",
                "rightsUri": about.licence_url,
            }
        ],
        "descriptions": [{"description": about.description or about.title, "descriptionType": "Abstract"}],
    }


def _checksums(target: Path) -> str:
    """SHA-256 of every file, as sha256sum wants them."""
    lines = []
    for path in sorted(path for path in target.rglob("*") if path.is_file()):
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        lines.append(f"{digest}  {path.relative_to(target).as_posix()}\n")
    return "".join(lines)


# --- Height maps -----------------------------------------------------------------------------------------------------


def _inputs(table: Any) -> dict[str, str]:
    """Of every file that experiments name, where it will be in the publication, by a name of its own."""
    paths = dict.fromkeys(_paths(table))
    named: dict[str, str] = {}
    for path in paths:
        name, count = Path(path).name, 1
        while f"inputs/{name}" in named.values():
            count += 1
            name = f"{Path(path).stem}-{count}{Path(path).suffix}"
        named[path] = f"inputs/{name}"
    return named


def _paths(table: Any) -> Iterator[str]:
    """The values of all keys `path` of a table, and of those within it."""
    for value in table.values() if isinstance(table, dict) else table if isinstance(table, list) else ():
        yield from _paths(value)
    if isinstance(table, dict) and isinstance(table.get("path"), str):
        yield table["path"]


def _moved(table: Any, inputs: Mapping[str, str]) -> Any:
    """The same table, with the files' names in the publication."""
    if isinstance(table, dict):
        return {key: _moved(value, inputs) for key, value in table.items()}
    if isinstance(table, list):
        return [_moved(value, inputs) for value in table]
    return inputs.get(table, table) if isinstance(table, str) else table


# --- One file --------------------------------------------------------------------------------------------------------


def _write_single(whole: xr.Dataset, path: Path, attributes: Mapping[str, str]) -> None:
    """All measurements in one file, one experiment in memory at a time."""
    import h5netcdf

    lead = whole["experiment"].dims
    stacked = [str(name) for name, variable in whole.data_vars.items() if set(lead) <= set(variable.dims)]
    whole.drop_vars(stacked).assign_attrs(attributes).to_netcdf(path, engine="h5netcdf")
    with h5netcdf.File(path, "a") as file:
        file.dimensions.update({name: size for name, size in whole.sizes.items() if name not in file.dimensions})
        for name in stacked:
            variable = whole[name]
            own = variable.shape[len(lead) :]
            packed: dict[str, Any] = {}
            if len(own) > 3:
                chunks = (*(1 for _ in lead), *own)
                packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "chunks": chunks}
            kept = file.create_variable(name, variable.dims, variable.dtype, **packed)
            kept.attrs.update(variable.attrs)
            for at in np.ndindex(variable.shape[: len(lead)]):
                kept[at] = variable[at].values
