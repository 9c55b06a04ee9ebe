"""The albedo atlas beside Smith's models: `python docs/atlas_table.py out/albedo_atlas` renews docs/models.md.

Single scattering is Microfacet with Smith's height-correlated masking, more is SmithMultipleScattering; both with
Beckmann's distribution of the nominal alpha. Standard errors of all are in the table.
"""

import re
import sys
from pathlib import Path

import numpy as np
import xarray as xr

import gonio
from gonio.models import Beckmann, SmithMultipleScattering
from gonio.optics import Conductor, Mirror
from gonio.sphere import direction

PAGE = Path(__file__).with_name("models.md")
START, END = "<!-- docs/atlas_table.py -->\n", "<!-- end -->"
ALPHAS, THETAS = (0.1, 0.3, 0.5, 0.7, 1.0), (0.0, 45.0, 75.0, 85.0)
LOSSLESS = ("lossless: 1 hit", "Smith", "2 hits", "Smith", "3 and more", "Smith")
HEAD = ("alpha", "theta_i", *LOSSLESS, "gold: all", "Smith", "Smith, 1 hit")
RED = 650.0
WALKS = 1_000_000


def table(atlas: xr.Dataset) -> str:
    """Rows of roughness and incidence; measured values with the standard error of their last digits."""
    lines = [
        f"| {' | '.join(HEAD)} |",
        f"|{' --- |' * len(HEAD)}",
    ]
    for alpha in ALPHAS:
        for theta in THETAS:
            at = atlas.sel(surface_alpha=alpha, theta_i=theta, wavelength=RED, phi_i=0.0)
            lines.append(f"| {alpha:g} | {theta:g}° | {' | '.join(_row(at, alpha, theta))} |")
    return "\n".join(lines) + "\n"


def _row(at: xr.Dataset, alpha: float, theta: float) -> list[str]:
    wi, cells = direction(theta, 0.0), []
    lossless, gold = (
        SmithMultipleScattering(distribution=Beckmann(alpha), material=material, walks=WALKS).albedo(wi, (RED,))
        for material in (Mirror(), Conductor("Au"))
    )
    for place, order in enumerate(("1", "2", "3+"), 1):
        cells += [_measured(at.sel(material="Mirror()", order=order)), _number(lossless, place)]
    metal = at.sel(material="Conductor(name='Au')")
    return [*cells, _measured(metal.sel(order="all")), _number(gold, 0), _number(gold, 1)]


def _measured(value: xr.Dataset) -> str:
    return _with_error(float(value["albedo"]), float(value["albedo_standard_error"]))


def _number(estimate: object, place: int) -> str:
    value, error = (float(np.ravel(part[place])[0]) for part in estimate)
    return _with_error(value, error)


def _with_error(value: float, error: float) -> str:
    """0.8563(4): four decimals, and the standard error in units of the last."""
    digits = round(error * 1e4)
    return f"{value:.4f}({digits})" if digits else f"{value:.4f}"


if __name__ == "__main__":
    rows = table(gonio.open_campaign(sys.argv[1]))
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(re.sub(f"{START}.*?{END}", lambda _: START + rows + END, text, flags=re.S), encoding="utf-8")
    print(rows)
