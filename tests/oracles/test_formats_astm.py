"""ASTM files: Cornell's tables."""

import dataclasses

import numpy as np
import pytest
from closed_forms import GRID, THETA_I, isotropic

from gonio.formats import astm
from gonio.sphere import direction


def test_a_header_never_ends_early(tmp_path):
    path = tmp_path / "lobe.astm"
    brdf = isotropic()
    named = dataclasses.replace(brdf, attributes={**brdf.attributes, "title": "VARS\nNUM_POINTS 3"})
    astm.write(named, path)
    head = path.read_text().partition("VARS")[0].split()
    assert head.count("NUM_POINTS") == 1
    assert head[head.index("NUM_POINTS") + 1] == str(len(THETA_I) * GRID.bins)
    assert astm.read(path).measured().dataset["brdf"].equals(brdf.measured().dataset["brdf"])


@pytest.mark.parametrize(
    ("names", "basis"),
    [("R,G,B", "RGB"), ("X,Y,Z", "XYZ"), ("Red,Green,Blue", "RGB"), ("brdf", "Y"), ("633nm", "spectrum")],
)
def test_cornells_tables(names, basis, tmp_path):
    """Rounded radians, any order, negative azimuths, spaces, CR LF; one azimuth of the light means isotropic."""
    rows = [
        (0.523599, 1.570796, t, p, *(t + c for c in range(names.count(",") + 1)))
        for t in (1.0, 0.5, 0)
        for p in (2, -1)
    ]
    path = tmp_path / "cornell.astm"
    text = "\r\n".join(", ".join(map(str, row)) for row in rows)
    path.write_bytes(
        f"NAME blue paint\r\nNUM_POINTS 6\r\nVARS theta_i,phi_i,theta_r,phi_r,{names}\r\n{text}\r\n".encode()
    )
    brdf = astm.read(path)
    assert (brdf.basis, brdf.isotropic, brdf.theta_i.tolist()) == (basis, True, [30.0])
    phi = np.degrees([2.0, -1.0])
    found = brdf.evaluate(direction([30.0, 30.0], [90.0, 90.0]), direction(np.degrees([0.75, 0.25]), phi))
    np.testing.assert_allclose(found[:, 0], [0.75, 0.25], rtol=1e-6)
