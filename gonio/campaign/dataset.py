"""All measurements of a campaign as one labelled array, read from its files when values are asked for."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from gonio.campaign.store import CampaignStore, keys_of, measurement_file
from gonio.toml_files import InputError

SINGLE = "campaign.nc"
"""The file of a campaign that was published as one."""

SAME = ("theta_i", "phi_i", "wavelengths", "detector", "orders", "azimuth")
"""What all experiments' goniometers must have in common for one array to hold them."""


COMMON = ("Conventions", "summary", "creator_name", "license", "keywords", "source")
"""Attributes that all files of a published campaign share."""


def open_campaign(folder: str | Path) -> xr.Dataset:
    """The measurements of a campaign's folder, or of a published one, as one lazily loaded Dataset.

    The variables are those of `Measurement.dataset`. The swept parameters are dimensions in front of theirs, called
    surface_alpha for surface.alpha: `data.brdf.sel(surface_alpha=0.3, material_name="Au")`. Parameters that step
    together share a dimension; where not all values were crossed, as in a random design, the dimension is `experiment`
    and all parameters are coordinates along it. What is not complete is NaN, and 0 where it was to be counted.

    Raises `InputError` for a folder without merged measurements, and if experiments differ in their incidences,
    wavelengths or detectors: such measurements are opened one by one.
    """
    folder = Path(folder)
    if (folder / SINGLE).exists():
        return xr.open_dataset(folder / SINGLE, engine="h5netcdf")
    store = CampaignStore(folder)
    manifest = store.manifest()
    entries = manifest["experiments"]
    _refuse_differences(folder, entries)
    paths = [store.measurements / measurement_file(entries, number) for number in range(len(entries))]
    files = [path if path.exists() else None for path in paths]
    if not any(files):
        raise InputError(f"{folder}: has no merged measurements yet; first: gonio campaign merge {folder}")
    whole = _stacked(Layout.of([entry["parameters"] for entry in entries]), files)
    return whole.assign_attrs(title=manifest["title"], versions=json.dumps(manifest["versions"]))


def _refuse_differences(folder: Path, entries: Sequence[Mapping[str, Any]]) -> None:
    """Raise `InputError` unless all experiments have the same bins."""
    first, *others = (entry["experiment"]["goniometer"] for entry in entries)
    for name in SAME:
        if any(other.get(name) != first.get(name) for other in others):
            raise InputError(
                f"{folder}: goniometer.{name} differs between experiments, which one array cannot hold; open the files "
                "in measurements/ one by one with gonio.load (index.csv lists them)."
            )


# --- How the experiments are laid out --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout:
    """Which parameters are dimensions, and which experiment is where."""

    points: Sequence[Mapping[str, Any]]
    """The parameters' values of every experiment."""
    places: NDArray[np.int64]
    """Numbers of the experiments, from 0, over the dimensions."""
    keys: Sequence[str] = ()
    """The parameters that are dimensions; none if `experiment` is the only one."""
    along: Mapping[str, str] = field(default_factory=dict)
    """Of parameters that step together with one of them, which."""

    @classmethod
    def of(cls, points: Sequence[Mapping[str, Any]]) -> Layout:
        """A dimension for every parameter if all their values were crossed, else one of all experiments."""
        keys, along = list[str](), dict[str, str]()
        columns = {key: [json.dumps(point.get(key)) for point in points] for key in keys_of(points)}
        for key, column in columns.items():
            leader = next((other for other in keys if _settles(columns[other], column)), None)
            if leader:
                along[key] = leader
            else:
                keys.append(key)
        values = [list(dict.fromkeys(columns[key])) for key in keys]
        if not keys or math.prod(map(len, values)) != len(points):
            return cls(points, np.arange(len(points)))
        places = np.full(tuple(map(len, values)), -1)
        for number, at in enumerate(zip(*(columns[key] for key in keys), strict=True)):
            places[tuple(listed.index(value) for listed, value in zip(values, at, strict=True))] = number
        if (places < 0).any():
            return cls(points, np.arange(len(points)))
        return cls(points, places, keys, along)

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions."""
        return tuple(map(variable_name, self.keys)) or ("experiment",)

    def coordinates(self) -> dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, str]]]:
        """(dimensions, values, attributes) of every parameter, and of the experiments' numbers, from 1."""
        found = {"experiment": (self.dims, self.places + 1, {"long_name": "number of the experiment in index.csv"})}
        for key in keys_of(self.points):
            leader = key if key in self.keys else self.along.get(key)
            dims, numbers = self.dims, self.places
            if leader is not None:
                axis = list(self.keys).index(leader)
                dims = (self.dims[axis],)
                numbers = np.moveaxis(self.places, axis, 0).reshape(self.places.shape[axis], -1)[:, 0]
            values = _column([self.points[number].get(key) for number in numbers.ravel().tolist()]).reshape(
                numbers.shape
            )
            found[variable_name(key)] = (dims, values, {"long_name": key})
        return found


def _settles(leader: Sequence[str], column: Sequence[str]) -> bool:
    """Whether the value of one parameter settles that of another."""
    return len(set(zip(leader, column, strict=True))) == len(set(leader))


def variable_name(key: str) -> str:
    """What a parameter is called in a Dataset: surface_alpha for surface.alpha, as CF wants names."""
    return key.replace(".", "_")


def _column(values: Sequence[Any]) -> NDArray[Any]:
    """Numbers as numbers, and everything else as text; what is not given is NaN or empty."""
    if all(value is None or type(value) in (int, float) for value in values):
        return np.array([math.nan if value is None else value for value in values])
    return np.array(["" if value is None else _label(value) for value in values], object)


def _label(value: Any) -> str:
    """A value as text; a recipe as Python, such as Conductor(name='Au')."""
    if isinstance(value, dict) and "kind" in value:
        return f"{value['kind']}({', '.join(f'{key}={part!r}' for key, part in value.items() if key != 'kind')})"
    return value if isinstance(value, str) else json.dumps(value)


# --- Reading from many files -----------------------------------------------------------------------------------------


def _stacked(layout: Layout, files: Sequence[Path | None]) -> xr.Dataset:
    """The Dataset over all files, which are laid out as the experiments are; none is read but the first."""
    paths = np.array([*files, None], object)[layout.places]
    with xr.open_dataset(next(filter(None, files)), engine="h5netcdf") as sample:
        variables = {}
        for name, variable in sample.variables.items():
            if "theta_i" in variable.dims and name in sample.data_vars:
                lazy = indexing.LazilyIndexedArray(_Stack(paths, str(name), variable.shape, variable.dtype))
                variables[name] = xr.Variable((*layout.dims, *variable.dims), lazy, variable.attrs)
            else:
                variables[name] = variable.load()
        shared = {name: variables.pop(name) for name in sample.coords}
        common = {name: text for name, text in sample.attrs.items() if name in COMMON}
    return xr.Dataset(variables, {**layout.coordinates(), **shared}, common)


class _Stack(BackendArray):
    """A variable of many files as one array: over the layout of the files, then over its own dimensions."""

    def __init__(self, paths: NDArray[Any], name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self._paths, self._name, self._part = paths, name, shape
        self.shape, self.dtype = (*paths.shape, *shape), dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        paths, inner = _picked(self._paths, key[: self._paths.ndim]), key[self._paths.ndim :]
        unknown = np.nan if self.dtype.kind == "f" else 0
        empty = _picked(np.broadcast_to(np.array(unknown, self.dtype), self._part), inner)
        read = np.empty((*paths.shape, *empty.shape), self.dtype)
        for at, path in np.ndenumerate(paths):
            read[at] = empty if path is None else self._from(path, inner)
        return read

    def _from(self, path: Path, key: tuple[Any, ...]) -> NDArray[Any]:
        import h5py

        with h5py.File(path) as file:
            return _picked(file[self._name], key)


def _picked(array: Any, key: tuple[Any, ...]) -> NDArray[Any]:
    """The part of an array, or of an HDF5 dataset, that integers, slices and arrays of integers pick axis by axis."""
    spans, picks = list[int | slice](), list[ArrayLike]()
    for part, size in zip(key, array.shape, strict=True):
        if isinstance(part, int | np.integer):
            spans.append(int(part))
            continue
        chosen = np.arange(size)[part]
        first, end = (int(chosen.min()), int(chosen.max()) + 1) if chosen.size else (0, 0)
        spans.append(slice(first, end))
        picks.append(chosen - first)
    found = np.asarray(array[tuple(spans)])
    return found[np.ix_(*picks)] if picks else found
