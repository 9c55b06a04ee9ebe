"""HeightField: periodic heights on a grid; ISO 25178 statistics, slopes, normals, correlation, spectrum; to a Mesh."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microsurfaces.arrays import Floats
from microsurfaces.html_card import html_card, image
from microsurfaces.mesh import (
    Facets,
    Mesh,
    Statistics,
    height_fields,
    normal_density,
    read_only,
    slope_cdf,
    slope_density,
    slope_moments,
)

PICTURED = 160
"""Nodes along either side of what a notebook shows."""


@dataclass(frozen=True, eq=False)
class HeightField:
    """One period of a single-valued surface; `heights` is read-only.

    `heights` (ny, nx) µm: node (j, i) lies at x = i dx, y = j dy, and the node after the last is the first again.
    `spacing` (dx, dy) µm. Raises ValueError for anything but finite heights on at least 2 x 2 nodes.
    """

    heights: Floats
    spacing: tuple[float, float]

    def __post_init__(self) -> None:
        """Lock the heights and check them."""
        object.__setattr__(self, "heights", read_only(self.heights, np.float64))
        object.__setattr__(self, "spacing", (float(self.spacing[0]), float(self.spacing[1])))
        if self.heights.ndim != 2 or min(self.heights.shape) < 2:
            raise ValueError(f"heights has shape {self.heights.shape}: expected a map (ny, nx) of at least 2 x 2 nodes")
        if bad := self.heights.size - int(np.count_nonzero(np.isfinite(self.heights))):
            raise ValueError(
                f"{bad} of {self.heights.size} heights are NaN or infinite: fill the gaps of the map first"
            )
        if not all(np.isfinite(step) and step > 0 for step in self.spacing):
            raise ValueError(f"spacing is {self.spacing}: expected two positive lengths in µm")

    @property
    def period(self) -> tuple[float, float]:
        """Size (px, py) of the tile, µm."""
        ny, nx = self.heights.shape
        return nx * self.spacing[0], ny * self.spacing[1]

    def _repr_html_(self) -> str:
        """What a notebook shows: its middle, lit from the left, and key numbers."""
        ny, nx = self.heights.shape
        slopes = [float(np.sqrt(np.mean(self._edge_slopes(axis) ** 2))) for axis in (1, 0)]
        rows = {
            "tile": f"{self.period[0]:.4g} x {self.period[1]:.4g} µm, periodic",
            "nodes": f"{nx} x {ny}, {self.spacing[0]:.3g} x {self.spacing[1]:.3g} µm apart",
            "heights": f"{self.heights.min():.3g} to {self.heights.max():.3g} µm, Sq = {self.heights.std():.3g} µm",
            "rms slopes": f"{slopes[0]:.3g} along x, {slopes[1]:.3g} along y",
        }
        return html_card("HeightField", rows, self._picture())

    def _picture(self) -> str:
        """An image of the middle of the tile, y upward, its slopes along x as grey."""
        ny, nx = self.heights.shape
        rows, columns = (slice((n - min(n, PICTURED)) // 2, (n + min(n, PICTURED)) // 2) for n in (ny, nx))
        # One column more, the first again after the last: a difference each.
        middle = self.heights[rows].take(np.arange(columns.start, columns.stop + 1), axis=1, mode="wrap")
        slope = np.diff(middle, axis=1)[::-1] / self.spacing[0]
        grey = np.clip(127.5 + 127.5 / 3 * slope / (np.sqrt(np.mean(slope**2)) or 1.0), 0, 255).astype(np.uint8)
        larger = max(1, PICTURED // max(grey.shape))
        pixels = np.repeat(np.repeat(grey, larger, axis=0), larger, axis=1)
        return image(pixels, f"{grey.shape[1]} x {grey.shape[0]} nodes in the middle, light from the left")

    def mesh(self) -> Mesh:
        """Two triangles a cell, their diagonals alternating as on a chess board, on (ny+1)(nx+1) vertices.

        Alternation takes away the ±45° anisotropy that one diagonal gives a mesh. Faces are in the order of the cells,
        lower triangle first.
        """
        ny, nx = self.heights.shape
        vertices = np.empty((ny + 1, nx + 1, 3))
        vertices[..., 0] = np.arange(nx + 1) * self.spacing[0]
        vertices[..., 1] = (np.arange(ny + 1) * self.spacing[1])[:, None]
        vertices[..., 2] = np.pad(self.heights, ((0, 1), (0, 1)), mode="wrap")
        index = np.arange((ny + 1) * (nx + 1), dtype=np.int32).reshape(ny + 1, nx + 1)
        v00, v10, v01, v11 = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        falling = self._falling()
        faces = np.empty((ny, nx, 2, 3), dtype=np.int32)
        faces[..., 0, 0], faces[..., 0, 1], faces[..., 0, 2] = v00, v10, np.where(falling, v01, v11)
        faces[..., 1, 0], faces[..., 1, 1], faces[..., 1, 2] = np.where(falling, v10, v00), v11, v01
        return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), self.period, single_valued=True)

    def _falling(self) -> NDArray[np.bool_]:
        """Cells (ny, nx) whose diagonal runs from (1, 0) to (0, 1); the others' runs from (0, 0) to (1, 1)."""
        ny, nx = self.heights.shape
        falling: NDArray[np.bool_] = (np.arange(ny)[:, None] + np.arange(nx)) % 2 == 0
        return falling

    def slopes(self) -> tuple[Floats, Floats]:
        """Slopes (p, q) = (dz/dx, dz/dy) of the facets, each (ny, nx, 2), in the order of the mesh's faces."""
        along_x, along_y = self._edge_slopes(1), self._edge_slopes(0)
        p = np.stack([along_x, np.roll(along_x, -1, axis=0)], axis=-1)
        near, far = along_y, np.roll(along_y, -1, axis=1)
        falling = self._falling()
        return p, np.stack([np.where(falling, near, far), np.where(falling, far, near)], axis=-1)

    def _edge_slopes(self, axis: int) -> Floats:
        """Slope of the edge from each node to the next along the axis, (ny, nx)."""
        return (np.roll(self.heights, -1, axis=axis) - self.heights) / self.spacing[1 - axis]

    def normals(self) -> Floats:
        """Unit facet normals (2 ny nx, 3), upward, in the order of the mesh's faces."""
        p, q = self.slopes()
        normals = np.stack([-p.ravel(), -q.ravel(), np.ones(p.size)], axis=-1)
        normals /= np.sqrt(1 + p.ravel() ** 2 + q.ravel() ** 2)[:, None]
        return normals

    def statistics(self) -> Statistics:
        """Roughness of the tile: heights over the nodes, slopes over the facets, lengths from the correlation."""
        z = self.heights - self.heights.mean()
        z2 = z * z
        heights = height_fields(float(np.abs(z).mean()), *(float(power.mean()) for power in (z2, z2 * z, z2 * z2)))
        # Each edge bounds one lower and one upper facet, so that the mean over facets is the mean over edges.
        slopes = slope_moments(*(float(np.mean(self._edge_slopes(axis) ** 2)) for axis in (1, 0)))
        return Statistics(**heights, **slopes, **self._correlation_lengths())

    @functools.cached_property
    def facets(self) -> Facets:
        """Fineness, tilt and curvature of the facets."""
        p, q = self.slopes()
        curvature = max(self._rms_curvature(axis) for axis in (1, 0))
        return Facets(
            triangles=p.size,
            period=self.period,
            spacing=self.spacing,
            single_valued=True,
            radius_of_curvature=1 / curvature if curvature > 0 else None,
            slope_cdf=slope_cdf(p.ravel(), q.ravel()),
        )

    def _rms_curvature(self, axis: int) -> float:
        """Root mean square of the second derivative along the axis, 1/µm."""
        slope = self._edge_slopes(axis)
        return float(np.sqrt(np.mean((slope - np.roll(slope, 1, axis=axis)) ** 2)) / self.spacing[1 - axis])

    def _correlation_lengths(self) -> dict[str, float | None]:
        if not np.ptp(self.heights):
            return {}
        acf = self.acf()
        x, y = (_first_crossing(line, step) for line, step in zip((acf[0], acf[:, 0]), self.spacing, strict=True))
        mean = None if x is None or y is None else float(np.sqrt(x * y))
        return {"correlation_length_x": x, "correlation_length_y": y, "correlation_length": mean}

    def acf(self) -> Floats:
        """Periodic autocorrelation of the heights about their mean, (ny, nx), 1 at lag (0, 0).

        Raises ValueError for a flat surface, which has none.
        """
        power = np.abs(np.fft.rfft2(self.heights - self.heights.mean())) ** 2
        acf = np.fft.irfft2(power, s=self.heights.shape)
        if not acf[0, 0] > 0:
            raise ValueError("the surface is flat: it has no autocorrelation")
        return np.asarray(acf / acf[0, 0])

    def psd(self) -> tuple[Floats, Floats, Floats]:
        """Power spectral density of the heights, (ny, nx) µm⁴, two-sided: (psd, kx, ky) in the order of the FFT.

        kx (nx,) and ky (ny,) are in rad/µm, and Sq² = Σ psd dkx dky / 4π².
        """
        ny, nx = self.heights.shape
        dx, dy = self.spacing
        psd = np.abs(np.fft.fft2(self.heights - self.heights.mean())) ** 2 * (dx * dy / (nx * ny))
        kx, ky = (np.asarray(2 * np.pi * np.fft.fftfreq(n, step), np.float64) for n, step in ((nx, dx), (ny, dy)))
        return psd, kx, ky

    def slope_distribution(self, bins: int = 101, limit: float | None = None) -> tuple[Floats, Floats, Floats]:
        """Density P22 of the facet slopes, as `Mesh.slope_distribution`: (density (bins, bins), p_edges, q_edges)."""
        p, q = self.slopes()
        return slope_density(p, q, np.full(p.shape, 1 / p.size), bins, limit)

    def normal_distribution(self, theta_bins: int = 90, phi_bins: int = 1) -> tuple[Floats, Floats, Floats]:
        """Distribution D of the facet normals, 1/sr, as `Mesh.normal_distribution`: (D, theta_edges, phi_edges)."""
        normals = self.normals()
        return normal_density(normals, 1 / (normals[:, 2] * len(normals)), theta_bins, phi_bins)


def _first_crossing(acf: Floats, step: float) -> float | None:
    """Lag at which the line first falls to 1/e, interpolated linearly; None if it does not within half a period."""
    below = np.flatnonzero(acf[: len(acf) // 2 + 1] <= np.exp(-1))
    if not below.size:
        return None
    k = int(below[0])
    return float(step * (k - (np.exp(-1) - acf[k]) / (acf[k - 1] - acf[k])))
