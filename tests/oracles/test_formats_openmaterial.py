"""OpenMATERIAL tables follow the schema, and tables of others are read as they are meant."""

import json
import math

import jsonschema
import numpy as np
import pytest
from closed_forms import anisotropic, isotropic

from gonio.formats import openmaterial
from gonio.sphere import direction

WAVELENGTH = {"type": "number", "minimum": 1e-9, "maximum": 17.16e-3}
SOLID_ANGLE = {"type": "number", "exclusiveMinimum": 0}
TEXTS = {"type": "array", "items": {"type": "string"}, "minItems": 1}
OPENMATERIAL = {
    "type": "object",
    "required": ["metadata", "brdf"],
    "properties": {
        "metadata": {
            "type": "object",
            "required": [
                "name",
                "uuid",
                "materialVersion",
                "openMaterial3dVersion",
                "copyrights",
                "license",
                "authors",
                "sources",
            ],
            "properties": {
                **{name: {"type": "string"} for name in ("name", "description", "license", "sources")},
                "uuid": {"type": "string", "pattern": "^[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}$"},
                "materialVersion": {"type": "string", "pattern": r"^\d+\.\d+\.\d+$"},
                "openMaterial3dVersion": {"type": "string", "pattern": r"^\d+\.\d+\.\d+$"},
                "creationDate": {"type": "string", "pattern": r"^\d{8}T\d{6}Z$"},
                **dict.fromkeys(("copyrights", "authors"), TEXTS),
            },
        },
        "brdf": {
            "type": "object",
            "required": ["wavelengths", "lookupTable"],
            "properties": {
                "wavelengths": {"type": "array", "items": WAVELENGTH},
                "receiverSolidAngles": {
                    "type": "array",
                    "items": {
                        "type": "object",
                        "required": ["wavelength", "solidAngle"],
                        "properties": {"wavelength": WAVELENGTH, "solidAngle": SOLID_ANGLE},
                    },
                },
                "lookupTable": {
                    "type": "array",
                    "items": {
                        "type": "array",
                        "minItems": 5,
                        "maxItems": 5,
                        "prefixItems": [
                            WAVELENGTH,
                            {"type": "number", "minimum": 0, "maximum": 1.570796},
                            {"type": "number", "minimum": 0, "maximum": 1.570796},
                            {"type": "number", "minimum": 0, "maximum": 6.283185},
                            {"type": ["number", "null"], "minimum": 0},
                        ],
                    },
                },
            },
        },
    },
}
"""Condensed from the documentation of ASAM OpenMATERIAL 3D 1.1, "Material brdf schema"."""


@pytest.mark.parametrize("source", [isotropic, lambda: isotropic(known=lambda t, d: t < 50), anisotropic])
def test_openmaterial_files_follow_the_schema(source, tmp_path):
    path = tmp_path / "lobe.xompt"
    brdf = source()
    notes = openmaterial.write(brdf, path)
    content = json.loads(path.read_text())
    errors = jsonschema.Draft202012Validator(OPENMATERIAL).iter_errors(content)
    assert not [error.message for error in errors]
    rows = [row[:4] for row in content["brdf"]["lookupTable"]]
    assert rows == sorted(rows)
    assert content["brdf"]["wavelengths"] == sorted({row[0] for row in rows}) == [4.5e-7, 5.5e-7, 6.328e-7]
    assert ("mean over 5 azimuths" in " ".join(notes)) == (not brdf.isotropic)


def test_openmaterial_files_tell_the_solid_angles_of_the_bins(tmp_path):
    path = tmp_path / "lobe.xompt"
    openmaterial.write(isotropic(), path)
    brdf = json.loads(path.read_text())["brdf"]
    rings = [ring["solidAngle"] for ring in brdf["binSolidAngles"]]
    assert 24 * sum(rings) == pytest.approx(2 * math.pi, rel=1e-14)
    # The ring about 30 degrees, from 25 to 35, in 24 parts.
    expected = (math.cos(math.radians(25)) - math.cos(math.radians(35))) * 2 * math.pi / 24
    assert rings[3] == pytest.approx(expected, rel=1e-12)
    receiver = {r["wavelength"]: r["solidAngle"] for r in brdf["receiverSolidAngles"]}
    assert receiver == pytest.approx(dict.fromkeys((4.5e-7, 5.5e-7, 6.328e-7), 2 * math.pi / 240))


def test_openmaterial_tables_of_others(tmp_path):
    """Angles rounded to six decimals, one side of the plane of incidence, null for what was not measured."""
    path = tmp_path / "theirs.xompt"
    table = [
        [nm, *(round(math.radians(angle), 6) for angle in (i, o, p)), None if o > 60 else o + p / 10]
        for nm in (4e-7, 5e-7)
        for i in (0, 30)
        for o in range(0, 81, 20)
        for p in range(0, 181, 45)
    ]
    path.write_text(
        json.dumps({"metadata": {"name": "asphalt"}, "brdf": {"wavelengths": [], "lookupTable": table}}, indent=4)
    )
    brdf = openmaterial.read(path)
    assert (brdf.title, brdf.wavelengths.tolist(), brdf.theta_i.tolist()) == ("asphalt", [400.0, 500.0], [0.0, 30.0])
    found = brdf.evaluate(direction([30.0] * 3, 0.0), direction([30.0, 30.0, 80.0], [100.0, -100.0, 0.0]))
    np.testing.assert_allclose(found[:2], 40.0, rtol=1e-5)
    assert np.isnan(found[2]).all()
