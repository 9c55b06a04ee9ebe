"""A campaign's folder: manifest.json says what was asked, units/ holds a file for every finished unit of work.

A unit's file is named by the hash of what it computes, so it can be written by anyone, any number of times, and never
be stale: two runs in one folder do no harm. It is written under a temporary name, flushed to the disk and renamed, and
holds a checksum of its content. Files in claims/ only advise other runs to compute something else first.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import secrets
import socket
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.toml_files import InputError

Arrays = Mapping[str, NDArray[Any]]

FORMAT_VERSION = 1
"""Of a unit's file and of the manifest: the names and units of what they hold."""

ABANDONED_SECONDS = 3600.0
"""A temporary file this old was left behind by a run that was killed."""


class DamagedError(ValueError):
    """A unit's file does not hold what was written."""


@dataclass(frozen=True)
class CampaignStore:
    """The folder of a campaign."""

    path: Path

    @property
    def manifest_file(self) -> Path:
        """What was asked."""
        return self.path / "manifest.json"

    @property
    def units(self) -> Path:
        """Where the finished units are."""
        return self.path / "units"

    @property
    def measurements(self) -> Path:
        """Where `merge` writes."""
        return self.path / "measurements"

    def create(self, manifest: Mapping[str, Any]) -> bool:
        """Make the folder, or go on in it; whether it held another campaign, whose units are kept."""
        for folder in (self.units, self.path / "claims"):
            folder.mkdir(parents=True, exist_ok=True)
        self._sweep_up()
        content = json.dumps(manifest, indent=1).encode()
        before = self.manifest_file.read_bytes() if self.manifest_file.exists() else None
        if before != content:
            write_durably(self.manifest_file, content)
        return before is not None and before != content

    def manifest(self) -> dict[str, Any]:
        """What was asked. Raises `InputError` where there is no campaign, or one that this version cannot read."""
        try:
            manifest: dict[str, Any] = json.loads(self.manifest_file.read_text(encoding="utf-8"))
        except OSError:
            raise InputError(f"{self.path}: holds no campaign (there is no manifest.json to read).") from None
        except ValueError:
            raise InputError(
                f"{self.manifest_file} is damaged: run the campaign again, which keeps finished units."
            ) from None
        version = manifest.get("format_version", 0)
        if version != FORMAT_VERSION:
            raise InputError(
                f"{self.manifest_file}: its format_version is {version}, and this gonio reads {FORMAT_VERSION}: run "
                "the campaign again, or read it with the gonio that wrote it."
            )
        return manifest

    def finished(self) -> set[str]:
        """Names of the units that have a file."""
        if not self.units.is_dir():
            return set()
        with os.scandir(self.units) as entries:
            return {entry.name[:-4] for entry in entries if entry.name.endswith(".npz") and entry.name[0] != "."}

    def has(self, unit: str) -> bool:
        """Whether a unit has a file."""
        return self._file(unit).exists()

    def write(self, unit: str, note: Mapping[str, Any], arrays: Arrays) -> None:
        """Keep a unit's sums; `note` tells what it is. Raises OSError where nothing can be written."""
        write_durably(self._file(unit), pack(note, arrays))

    def read(self, unit: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """The note and the sums of a unit. Raises `DamagedError` unless they are what was written under this name."""
        note, arrays = unpack(self._file(unit).read_bytes())
        if name_of(note.get("unit")) != unit:
            raise DamagedError("it is another unit's file under a wrong name")
        return note, arrays

    def set_aside(self, unit: str, error: DamagedError) -> str:
        """Move a damaged unit out of the way, so that it is computed again; a sentence that tells so."""
        aside = self.path / "damaged" / f"{unit}-{secrets.token_hex(4)}.npz"
        aside.parent.mkdir(exist_ok=True)
        self._file(unit).replace(aside)
        return f"{unit} is damaged, {error}: set aside as {aside}."

    def claim(self, unit: str, run: str) -> bool:
        """Tell other runs that this one computes the unit now; False if another one that may be alive said so first."""
        path = self.path / "claims" / unit
        claim = {"host": socket.gethostname(), "pid": os.getpid(), "run": run}
        for _ in range(2):
            try:
                with path.open("x", encoding="utf-8") as file:
                    json.dump(claim, file)
            except FileExistsError:
                held = _claim(path)
                if held is not None and held != claim and _may_be_alive(held):
                    return False
                path.unlink(missing_ok=True)
            else:
                return True
        return False

    def release(self, unit: str) -> None:
        """Take the claim back."""
        (self.path / "claims" / unit).unlink(missing_ok=True)

    def claims(self) -> dict[str, dict[str, Any]]:
        """Units that runs which may be alive compute now, and who they are."""
        folder = self.path / "claims"
        paths = folder.iterdir() if folder.is_dir() else ()
        held = {path.name: _claim(path) for path in paths}
        return {unit: claim for unit, claim in held.items() if claim is not None and _may_be_alive(claim)}

    def _file(self, unit: str) -> Path:
        return self.units / f"{unit}.npz"

    def _sweep_up(self) -> None:
        """Remove what killed runs left behind unfinished."""
        for path in (*self.path.glob(".*.tmp"), *self.units.glob(".*.tmp")):
            with contextlib.suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime > ABANDONED_SECONDS:
                    path.unlink()
        finished = self.finished()
        for path in (self.path / "claims").iterdir():
            if path.name in finished:
                path.unlink(missing_ok=True)


def name_of(key: Any) -> str:
    """The name of the unit that computes `key`: a hash of it, 32 hexadecimal digits."""
    return hashlib.blake2b(json.dumps(key, sort_keys=True).encode(), digest_size=16).hexdigest()


def measurement_file(entries: Sequence[Mapping[str, Any]], number: int) -> str:
    """The name of a merged measurement, of the manifest's experiment `number`; a hash tells it from earlier sweeps'."""
    key = [entries[number]["experiment"], entries[number]["units"]]
    return f"{number + 1:0{max(4, len(str(len(entries))))}d}-{name_of(key)[:8]}.nc"


def paths_of(manifest: Mapping[str, Any]) -> dict[str, int]:
    """How many paths each unit is planned to take, by its name."""
    entries = manifest["experiments"]
    return {unit: paths for entry in entries for unit, paths in zip(entry["units"], entry["paths"], strict=True)}


def keys_of(points: Sequence[Mapping[str, Any]]) -> list[str]:
    """The swept parameters: all keys of all experiments' `parameters`."""
    return list(dict.fromkeys(key for point in points for key in point))


def pack(note: Mapping[str, Any], arrays: Arrays) -> bytes:
    """A .npz file of arrays, with the note (JSON) and a checksum of everything; the same bytes for the same content."""
    text = json.dumps(note)
    members = {**arrays, "note": np.array(text), "checksum": np.array(_checksum(text, arrays))}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in members.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
    return content.getvalue()


def unpack(content: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The note and the arrays of `pack`. Raises `DamagedError` for anything else."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        text, checksum = str(arrays.pop("note")), str(arrays.pop("checksum"))
    except Exception:  # there is no end to what a damaged archive can provoke
        raise DamagedError("it cannot be read") from None
    if _checksum(text, arrays) != checksum:
        raise DamagedError("its checksum is wrong")
    note: dict[str, Any] = json.loads(text)
    return note, arrays


def _checksum(text: str, arrays: Arrays) -> str:
    digest = hashlib.blake2b(text.encode(), digest_size=16)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()


def write_durably(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all, even if the power fails."""
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    if os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _claim(path: Path) -> dict[str, Any] | None:
    """Who claims a unit; None if nobody does, or not yet legibly."""
    try:
        claim: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return claim


def _may_be_alive(claim: Mapping[str, Any]) -> bool:
    """Whether the run that made a claim may still be there; of another machine's nobody knows."""
    if os.name != "posix" or claim["host"] != socket.gethostname():
        return True
    try:
        os.kill(int(claim["pid"]), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
