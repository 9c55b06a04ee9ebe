"""Materials, detectors and surfaces that many tests measure with, and the rows of reference tables."""

import csv
from pathlib import Path

import microsurfaces as ms
from gonio.detectors import HemisphereGrid
from gonio.optics import CONDUCTORS, DIELECTRICS, Conductor, Dielectric, Mirror

GREEN = (550.0,)
"""Wavelengths, nm."""
RGB = (450.0, 550.0, 650.0)

GLASS = Dielectric(eta=1.5)
GOLD = Conductor("Au")
METALS = [Conductor(name) for name in CONDUCTORS]
GLASSES = [Dielectric(name) for name in DIELECTRICS]
SPECULAR = [Mirror(), *METALS, *GLASSES]
"""The materials that reflect a ray into one direction, by all the tables there are."""

GRID = HemisphereGrid(theta_step=5.0, phi_step=15.0)
COARSE_GRID = HemisphereGrid(theta_step=15.0, phi_step=30.0)

STEEP = ms.Gaussian(alpha=0.6, samples=128, side=80.0, correlation_length=8.0)
"""A small tile with steep slopes: most light that grazes it is hit again behind a seam."""


def reference_table(name):
    """The rows of tests/data/`name`.csv, as the strings that stand there by the names of their columns."""
    text = (Path(__file__).parent / "data" / f"{name}.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))
