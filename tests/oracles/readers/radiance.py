"""Radiance's own library and programs, by pyradiance."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyradiance

from gonio.sphere import angles

QUERIES = """
import sys, numpy
from pyradiance import bsdf
data = bsdf.load_file(sys.argv[1])
places = numpy.load(sys.argv[2])
values = [bsdf.query(data, *place) for place in places.tolist()]
totals = [bsdf.direct_hemi(data, *place[:2], bsdf.SAMPLE_ALL) for place in places[:100].tolist()]
numpy.savez(sys.argv[2] + ".npz", values=values, totals=totals)
"""


def query(path, wi, wo):
    """XYZ of Radiance at pairs of directions, and the hemispherical reflectances of the first hundred.

    In a process of its own: loading a second file, or freeing the first, may end it.
    """
    places = path.with_suffix(".npy")
    np.save(places, np.stack([*angles(wi), *angles(wo)], axis=1))
    subprocess.run([sys.executable, "-c", QUERIES, path, places], check=True, timeout=100)
    with np.load(f"{places}.npz") as found:
        return found["values"], found["totals"]


def run(folder, *command, **options):
    """What one of Radiance's programs puts out, as bytes."""
    programs = Path(pyradiance.__file__).parent
    environment = {**os.environ, "RAYPATH": f".:{programs / 'lib'}", "PATH": f"{programs / 'bin'}:{os.environ['PATH']}"}
    command = [programs / "bin" / command[0], *command[1:]]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=100, check=True, **options)
    return done.stdout
