"""Zemax OpticStudio tabular BSDF `.bsdf`: scattering for lens design and stray light.

Opens in OpticStudio, which uses it for one azimuth of the sample and one tristimulus at a time, and in BSDFProcessor
(libbsdf). Lines of text, `#` comments first:

    Source  Measured
    Symmetry  PlaneSymmetrical | Asymmetrical | Asymmetrical4D
    SpectralContent  Monochrome | XYZ
    ScatterType  BRDF
    SampleRotation  n, AngleOfIncidence  n, ScatterAzimuth  n, ScatterRadial  n   and after each a line of n angles

then for each channel its name (Monochrome, or TristimulusX, Y and Z), `DataBegin`, for every rotation and incidence a
line `TIS t` and a line for each azimuth with a value for each radial angle, and `DataEnd`.

Angles are in degrees. Directions of scatter are counted from the specular direction: radial is the angle from it,
azimuth 0 points from it toward the normal, 90 to +y if the light is in the +x half plane. Values are f_r in 1/sr, no
cosine; TIS is the directional albedo. PlaneSymmetrical tables have azimuths from 0 to 180. A rotation is taken to be
phi_i of the light, as libbsdf has it; the vendor describes it as a turn of the sample and uses a single one.

Programs interpolate linearly in azimuth and radial angle, and between incidences at the same two angles about either
specular direction. The table is therefore fine where lobes are, at the specular direction, and has an incidence every
2.5 degrees (10 for anisotropic ones) that follows the lobe. Directions below the horizon have no value; to keep them
from pulling down their neighbours, those next to the horizon hold the value above it. Errors are lost, and so are
wavelengths: a spectrum becomes its CIE Y or XYZ under D65.

"Zemax Tabular BSDF data file format", support.zemax.com, article 1500005486801; Radiant Imaging, 2008.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.brdf import BRDF, NOMINAL, Basis
from gonio.formats.scattered.bins import grid_of_steps
from gonio.formats.text import decimal, numbers, title_of
from gonio.interpolation import bracket, bracket_around
from gonio.sphere import angles, direction
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.atomic_write import atomic_write

RADIAL = np.concatenate(
    [np.arange(0, 6, 0.25), np.arange(6, 20, 0.5), np.arange(20, 50, 1), np.arange(50, 90, 2), np.arange(90, 181, 5)]
)
"""Nodes of what is written, degrees."""

STEPS = {True: (2.5, 3.0), False: (10.0, 5.0)}
"""Between incidences and between azimuths, degrees, for isotropic tables and for others, which are much larger."""

SYMMETRIC = 0.05
"""BRDFs that differ from their mirror images by less than this share of their energy are taken to be symmetric."""

LARGEST = 1 << 29
"""Bytes that a file may have."""

BLOCKS: Mapping[str, Sequence[str]] = {
    "Monochrome": ("Monochrome",),
    "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ"),
}
"""Names of the channels for each SpectralContent."""


@dataclass(frozen=True, eq=False)
class _Table:
    """What a file holds."""

    rotation: Floats
    """(P,), degrees."""
    incidence: Floats
    azimuth: Floats
    """(A,), from 0 to 180 if `symmetric`."""
    radial: Floats
    symmetric: bool
    values: Floats
    """(rotation, incidence, azimuth, radial, channels), 1/sr."""

    def at(self, wi: Vectors, wo: Vectors) -> Floats:
        """Linear in all angles, (n, channels)."""
        theta, phi = angles(wi)
        radial, azimuth = angles(np.einsum("nij,nj->ni", _frame(theta, phi), wo))
        around = (
            bracket(self.azimuth, np.minimum(azimuth, 360 - azimuth), "azimuth", "nearest")
            if self.symmetric
            else bracket_around(self.azimuth, azimuth, "nearest")
        )
        corners = (
            bracket_around(self.rotation, phi, "nearest"),
            bracket(self.incidence, theta, "theta_i", "nearest"),
            around,
            bracket(self.radial, radial, "radial", "nearest"),
        )
        value = np.zeros((len(theta), self.values.shape[-1]))
        for corner in itertools.product((0, 1), repeat=4):
            weight = np.ones(len(theta))
            for side, (_, share) in zip(corner, corners, strict=True):
                weight = weight * (share if side else 1 - share)
            if weight.any():
                place = tuple(nodes[side] for side, (nodes, _) in zip(corner, corners, strict=True))
                value += weight[:, None] * self.values[place]
        return np.where(wo[:, 2:] > 0, value, 0.0)


def _frame(theta: ArrayLike, phi: ArrayLike) -> Floats:
    """Rows: the axes of azimuth 0, azimuth 90 and radial 0 of light from these angles, (..., 3, 3)."""
    theta, phi = np.asarray(theta), np.asarray(phi)
    return np.stack([direction(90 - theta, phi), direction(90.0, phi + 90), direction(theta, phi + 180)], axis=-2)


# --- Writing ---------------------------------------------------------------------------------------------------------


def write(brdf: BRDF, path: Path, colour: bool = False) -> Sequence[str]:
    """Write a table of one channel, or with `colour` of X, Y and Z.

    Raises ValueError if one azimuth of the light is known of an anisotropic specimen, OSError where the file cannot be
    written.
    """
    content = "XYZ" if colour else "Monochrome"
    chosen = brdf.in_basis("XYZ") if colour else brdf if len(brdf.wavelengths) == 1 else brdf.in_basis("Y")
    table, notes = _sampled(chosen)
    symmetry, table = _symmetry(chosen, table, notes)
    albedos = _albedos(chosen, table, notes)
    with atomic_write(path) as scratch, scratch.open("w", encoding="utf-8", newline="\r\n") as file:
        file.write(_head(chosen, symmetry, content, table))
        for channel, name in enumerate(BLOCKS[content]):
            file.write(f"{name}\nDataBegin\n")
            blocks = table.values[..., channel].reshape(-1, *table.values.shape[2:4])
            for albedo, block in zip(albedos[..., channel].ravel(), blocks, strict=True):
                rows = "\n".join([" ".join(["%.6e"] * block.shape[1])] * block.shape[0])
                file.write(f"TIS {albedo:.6g}\n{rows % tuple(block.ravel().tolist())}\n")
            file.write("DataEnd\n")
    if not colour and len(brdf.wavelengths) > 1:
        notes.append(f"Monochrome holds CIE Y under D65 of {', '.join(brdf.channels)}")
    return notes


def _head(brdf: BRDF, symmetry: str, content: str, table: _Table) -> str:
    wavelength = f"# Wavelength {brdf.channels[0]}\n" if brdf.basis == "spectrum" else ""
    axes = {
        "SampleRotation": table.rotation,
        "AngleOfIncidence": table.incidence,
        "ScatterAzimuth": table.azimuth,
        "ScatterRadial": table.radial,
    }
    lists = "".join(f"{name}  {len(axis)}\n{' '.join(map(decimal, axis))}\n" for name, axis in axes.items())
    return (
        f"# {title_of(brdf.title)}\n# Written by gonio: BRDF in 1/sr, without cosine\n{wavelength}"
        f"Source  Measured\nSymmetry  {symmetry}\nSpectralContent  {content}\nScatterType  BRDF\n{lists}\n"
    )


def _sampled(brdf: BRDF) -> tuple[_Table, list[str]]:
    """The BRDF at all nodes, azimuths all around, and what had to be bent."""
    rotation = np.zeros(1) if brdf.isotropic else brdf.phi_i
    tilt, turn = STEPS[brdf.isotropic]
    incidence = np.union1d(brdf.theta_i, np.arange(0.0, 90.0, tilt))
    azimuth = np.arange(0.0, 361.0, turn)
    # Programs read a direction above the horizon at the incidences on either side of its own, too.
    apart = np.diff(incidence, append=90.0).max()
    local = direction(*np.meshgrid(RADIAL, azimuth))
    values = np.zeros((len(rotation), len(incidence), *local.shape[:2], len(brdf.wavelengths)))
    below = unknown = 0
    for (p, phi), (i, theta) in itertools.product(enumerate(rotation), enumerate(incidence)):
        wo = local @ _frame(theta, phi)
        above = wo[..., 2] > 0
        held = _beside(wo[..., 2] > -np.sin(np.radians(apart)))
        values[p, i][held] = _at_or_above(brdf, direction(theta, phi), wo[held])
        unknown += int(np.isnan(values[p, i]).any(axis=-1).sum())
        below += int((~above).sum())
    size = values[..., 0].size
    notes = [
        f"{below / size:.1%} of the table's directions lie below the horizon; those next to it hold the value above"
    ]
    if unknown:
        notes.append(f"nothing is known at {unknown / size:.1%} of them: they hold 0")
    first, last = brdf.theta_i[[0, -1]]
    if first > 0 or last < 85:
        notes.append(f"light was measured from {first:g} to {last:g} degrees: beyond, the nearest incidence stands")
    return _Table(rotation, incidence, azimuth, RADIAL, False, np.nan_to_num(values)), notes


def _beside(above: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Nodes (azimuth, radial) that have a part in values above the horizon."""
    held = above.copy()
    for axis in (0, 1):
        grown = held.copy()
        for ours, theirs in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            lead = (slice(None),) * axis
            grown[(*lead, ours)] |= held[(*lead, theirs)]
        held = grown
    return held


def _at_or_above(brdf: BRDF, wi: Vectors, wo: Vectors) -> Floats:
    """Values at `wo` (n, 3), or at the horizon where it is below."""
    raised = wo.copy()
    raised[:, 2] = np.where(wo[:, 2] > 0, wo[:, 2], 1e-3)
    raised /= np.linalg.norm(raised, axis=-1, keepdims=True)
    return brdf.evaluate(np.broadcast_to(wi, raised.shape), raised)


def _symmetry(brdf: BRDF, table: _Table, notes: list[str]) -> tuple[str, _Table]:
    """The word for the file, and what it holds: the mean of both sides if they differ by no more than noise."""
    if not brdf.isotropic:
        return "Asymmetrical4D", table
    mirrored = table.values[:, :, ::-1]
    weights = _shares(table)[..., None]
    difference = (weights * np.abs(table.values - mirrored)).sum(axis=(0, 2, 3))
    energy = (weights * table.values).sum(axis=(0, 2, 3))
    share = float((difference / np.where(energy > 0, 2 * energy, 1.0)).max())
    if share > SYMMETRIC + 3 * _noise(brdf):
        notes.append(f"{share:.1%} of the energy is not symmetric about the plane of incidence: Asymmetrical")
        return "Asymmetrical", table
    if share > 1e-6:
        notes.append(f"the mean of both sides of the plane of incidence, which differ by {share:.1%} of the energy")
    half = len(table.azimuth) // 2 + 1
    mean = (table.values + mirrored)[:, :, :half] / 2
    return "PlaneSymmetrical", _Table(table.rotation, table.incidence, table.azimuth[:half], table.radial, True, mean)


def _shares(table: _Table) -> Floats:
    """cosθ dω that each node stands for, (incidence, azimuth, radial)."""
    axes = np.broadcast_arrays(table.incidence[:, None, None], table.azimuth[:, None], table.radial)
    tilt, azimuth, radial = np.radians(axes)
    cosine = np.cos(radial) * np.cos(tilt) + np.sin(radial) * np.cos(azimuth) * np.sin(tilt)
    return np.asarray(np.maximum(cosine, 0.0) * np.sin(radial) * np.gradient(table.radial))


def _noise(brdf: BRDF) -> float:
    """The share of the energy by which two sides differ that only noise sets apart; 0 if errors are not known."""
    if brdf.measurement is None:
        return 0.0
    data = brdf.measurement.dataset.sel(order="all")
    bins = ("theta_o", "dphi")
    area = data["projected_solid_angle"]
    # Half the mean absolute difference of two normal variates.
    spread = (data["brdf_standard_error"] * area).sum(bins) / np.sqrt(np.pi)
    return float((spread / (data["brdf"] * area).sum(bins)).fillna(0.0).max())


def _albedos(brdf: BRDF, table: _Table, notes: list[str]) -> Floats:
    """Directional albedos (rotation, incidence, channels), at most 1; linear between the measured incidences."""
    known = brdf.measured().dataset["albedo"].sel(order="all").transpose("phi_i", "theta_i", "wavelength")
    known = known.isel(phi_i=slice(len(table.rotation)))
    albedo = np.empty((*table.values.shape[:2], len(brdf.wavelengths)))
    for p, channel in itertools.product(range(len(albedo)), range(albedo.shape[2])):
        albedo[p, :, channel] = np.interp(table.incidence, known["theta_i"].values, known.values[p, :, channel])
    if (albedo > 1 + 1e-6).any():
        notes.append(f"TIS is at most 1, where the albedo is {np.nanmax(albedo):.4g}")
    return np.asarray(np.clip(np.nan_to_num(albedo), 0.0, 1.0), np.float64)


# --- Reading ---------------------------------------------------------------------------------------------------------


def read(path: Path) -> BRDF:
    """A BRDF evaluated as libbsdf does. Raises ValueError in one sentence for anything else."""
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError(f"it is larger than {LARGEST >> 20} MiB")
        text = path.read_bytes().decode("utf-8", errors="replace")
        return _brdf(text, path.name)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path}: not a Zemax BSDF file: {title_of(error)}") from None


def _brdf(text: str, name: str) -> BRDF:
    comments = re.findall(r"^#(.*)$", text, flags=re.MULTILINE)
    head, *rest = re.split(
        r"^[ \t]*(Monochrome|Tristimulus[XYZ])[ \t\r]*$", re.sub(r"(?m)^#.*$", "", text), flags=re.MULTILINE
    )
    words = head.split()
    if _word(words, "ScatterType") != "BRDF":
        raise ValueError(f"it holds a {_word(words, 'ScatterType')[:20]}, expected a BRDF")
    content = _word(words, "SpectralContent")
    if content not in BLOCKS or list(BLOCKS[content]) != rest[::2]:
        raise ValueError(f"its SpectralContent {content[:20]!r} does not go with its {len(rest) // 2} blocks of data")
    table = _table(words, rest[1::2])
    basis, wavelengths = _channels(content, comments)
    step = max(1.0, float(np.diff(table.radial).min(initial=10.0)))
    return BRDF(
        evaluate=table.at,
        wavelengths=wavelengths,
        theta_i=table.incidence,
        phi_i=table.rotation,
        isotropic=len(table.rotation) == 1,
        basis=basis,
        detector=grid_of_steps(step, step),
        attributes={"title": title_of(next(iter(comments), name)), "origin": f"Zemax BSDF file {name}"},
    )


def _table(words: Sequence[str], blocks: Sequence[str]) -> _Table:
    rotation, incidence, azimuth, radial = (
        _angles(words, name) for name in ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
    )
    shape = tuple(len(axis) for axis in (rotation, incidence, azimuth, radial))
    values = []
    for block in blocks:
        found = numbers(re.sub(r"TIS[ \t]+\S*|DataBegin|DataEnd", " ", block))
        if len(found) != np.prod(shape, dtype=np.float64):
            raise ValueError(f"a block holds {len(found)} values, expected {' x '.join(map(str, shape))}")
        values.append(found.reshape(shape))
    symmetric = _word(words, "Symmetry") == "PlaneSymmetrical"
    return _Table(rotation, incidence, azimuth, radial, symmetric, np.stack(values, axis=-1))


def _word(words: Sequence[str], name: str) -> str:
    """What follows a keyword."""
    if name not in words[:-1]:
        raise ValueError(f"there is no {name}")
    return words[words.index(name) + 1]


def _angles(words: Sequence[str], name: str) -> Floats:
    """The list of angles that follows a keyword and its number."""
    count = _word(words, name)
    start = words.index(name) + 2
    if not count.isdecimal() or not 0 < int(count) <= len(words) - start:
        raise ValueError(f"{name} announces {count[:20]} angles, of which {len(words) - start} are there")
    angle = numbers(" ".join(words[start : start + int(count)]))
    most = 90 if name == "AngleOfIncidence" else 360
    if (np.diff(angle) <= 0).any() or angle[0] < 0 or angle[-1] > most:
        raise ValueError(f"{name} must increase from 0 to at most {most} degrees")
    return angle


def _channels(content: str, comments: Sequence[str]) -> tuple[Basis, Floats]:
    """What the values are, and at which wavelengths; Y if a monochrome file does not tell."""
    if content == "XYZ":
        return "XYZ", np.array(NOMINAL["XYZ"])
    for comment in comments:
        if told := re.fullmatch(r"\s*Wavelength (\d{1,9}(?:\.\d{1,9})?)nm\s*", comment):
            return "spectrum", np.array([float(told[1])])
    return "Y", np.array(NOMINAL["Y"])
