"""BiRD files follow the schema, and files of laboratories are read as they are meant."""

import dataclasses
import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from closed_forms import anisotropic, isotropic, lambertian, measured

from gonio.brdf import BRDF, NOMINAL
from gonio.detectors import HemisphereGrid
from gonio.formats import bird, json_arrays
from gonio.sphere import direction

DATA = Path(__file__).parents[1] / "data"


def schema_errors(content):
    schema = json.loads((DATA / "bird_schema.json").read_text())
    checker = jsonschema.Draft202012Validator(schema, format_checker=jsonschema.FormatChecker())
    return [error.message for error in checker.iter_errors(content)]


@pytest.mark.parametrize(
    "source",
    [
        isotropic,
        lambda: anisotropic(grid=HemisphereGrid(theta_step=30.0, phi_step=30.0)),
        lambda: isotropic(basis="RGB", wavelengths=NOMINAL["RGB"]),
        lambertian,
    ],
)
def test_bird_files_follow_the_schema(source, tmp_path):
    path = tmp_path / "lobe.json"
    bird.write(source(), path)
    content = json.loads(path.read_text())
    assert not schema_errors(content)
    lengths = {len(content["data"][n]["values"]) for n in content["data"] if n != "adhoc_variables"}
    assert len(lengths) == 1
    # The schema can tell a wrong file.
    content["data"]["phi_r"]["values"][0] = 360
    content["data"]["BRDF"]["unit"] = "sr"
    del content["metadata"]["sample"]
    assert len(schema_errors(content)) == 3


def bird_file(path, **changes):
    """A file as a laboratory would have it: in the plane of incidence, radians, micrometres, per cent."""
    data = {
        "wavelength_i": {"unit": "μm", "values": [0.55] * 6},
        "theta_i": {"unit": "rad", "values": [math.pi / 6] * 6},
        "phi_i": {"unit": "°", "values": [90] * 6},
        "theta_r": {"unit": "deg", "values": [0, 10, 20, 0, 10, 20]},
        "phi_r": {"unit": "deg", "values": [90, 90, 90, 270, 270, 270]},
        "BRDF": {"unit": "sr^-1", "values": [0.3, 0.35, 0.4, 0.3, 0.45, 0.6]},
        "uBRDF": {"unit": "%", "values": [1, 2, 3, 1, 2, 3]},
        **changes,
    }
    data = {name: variable for name, variable in data.items() if variable is not None}
    path.write_text(json.dumps({"metadata": {"description": "tile", "method": "measurement"}, "data": data}))
    return path


def test_bird_files_of_laboratories(tmp_path):
    brdf = bird.read(bird_file(tmp_path / "lab.json"))
    assert (brdf.title, brdf.isotropic, brdf.attributes["method"]) == ("tile", True, "measurement")
    assert (brdf.theta_i.item(), brdf.wavelengths.item()) == (30.0, 550.0)
    found = brdf.evaluate(direction(np.full(3, 30.0), 12.0), direction([5.0, 15.0, 20.0], [12.0, 192.0, 192.0]))
    np.testing.assert_allclose(found[:, 0], [0.325, 0.525, 0.6], rtol=1e-9)
    data = brdf.measured().dataset.sel(order="all", theta_o=20.0).isel(theta_i=0, phi_i=0, wavelength=0)
    # An average from 15 degrees on, beyond which nothing changes after 20.
    np.testing.assert_allclose(data["brdf_standard_error"].sel(dphi=180), 0.03 * 0.6, rtol=0.1)


def test_bird_uncertainties_polarisations_and_what_is_refused(tmp_path):
    path = tmp_path / "lab.json"
    values = [0.3, 0.35, 0.4, 0.3, 0.45, 0.6]
    single = {"unit": "1/sr", "values": values, "uncertainty": {"value": 0.02, "unit": "1/sr"}}
    data = bird.read(bird_file(path, uBRDF=None, BRDF=single)).measured().dataset
    assert np.nanmax(data["brdf_standard_error"]) == pytest.approx(0.02)
    # Two polarisations of the light, one below the other.
    names = ("wavelength_i", "theta_i", "phi_i", "theta_r", "phi_r")
    plain = json.loads(bird_file(path).read_text())["data"]
    doubled = {name: {**plain[name], "values": 2 * plain[name]["values"]} for name in names}
    both = {"unit": "1/sr", "values": [v - 0.1 for v in values] + [v + 0.1 for v in values]}
    states = {"notation": "sp", "values": ["s"] * 6 + ["p"] * 6}
    brdf = bird.read(bird_file(path, **doubled, BRDF=both, uBRDF=None, polarization_i=states))
    np.testing.assert_allclose(brdf.evaluate(direction([30.0], 0.0), direction([20.0], 180.0)), 0.6)
    for changes, complaint in (
        ({"polarization_r": {"notation": "sp", "values": ["s"] * 6}}, "analyser"),
        ({"theta_r": {"unit": "gon", "values": [0] * 6}}, "'gon', expected deg or rad"),
        ({"theta_r": {"unit": "deg", "values": [0] * 5}}, "expected 6"),
        ({"BRDF": {"unit": "1/sr", "values": [[1, 2]] * 3}}, "flat list"),
        ({"phi_r": None}, "'phi_r' is missing"),
    ):
        with pytest.raises(ValueError, match=complaint):
            bird.read(bird_file(path, **changes))


def test_negative_values_and_missing_errors_are_told(tmp_path):
    path = tmp_path / "lobe.json"
    source = measured()
    data = source.external.copy(deep=True)
    data["brdf"][0, 0, 0, 0, 0, 0] = -1.0
    data["brdf_standard_error"][0, 0, 0, 3, 0, 0] = np.nan
    notes = bird.write(BRDF.of(dataclasses.replace(source, external=data)), path)
    content = json.loads(path.read_text())
    assert "negative" in notes[0]
    assert "uBRDF" not in content["data"]
    assert content["data"]["BRDF"]["values"][0] == 0
    assert not schema_errors(content)


def test_long_arrays_are_taken_out_of_json(tmp_path):
    path = tmp_path / "long.json"
    numbers = np.random.default_rng(0).standard_normal(5000)
    rows = numbers.reshape(-1, 5)
    content = {
        "a": {"values": numbers.tolist(), "unit": "[1]"},
        "b": [{"values": rows.tolist()}],
        "c": {"values": ["u"] * 999},
    }
    for indent in (None, 1):
        path.write_text(json.dumps(content, indent=indent))
        found = json_arrays.load(path, "values")
        assert isinstance(found["a"]["values"], np.ndarray)
        np.testing.assert_array_equal(found["a"]["values"], numbers)
        np.testing.assert_array_equal(found["b"][0]["values"], rows)
        assert found["c"] == content["c"]
    for damaged, complaint in (
        ("[" + "1," * 3000 + "]]", "damaged"),
        ("[[" + "1,2],[" * 3000 + "3]", "damaged"),
        ("[" + "1 2," * 3000 + "3]", "white space between numbers"),
        ("[" + "1," * 3000 + "true]", "true"),
        ("[1," * 3000, "no JSON"),
    ):
        path.write_text(f'{{"values": {damaged}}}')
        with pytest.raises(ValueError, match=complaint):
            json_arrays.load(path, "values")
    path.write_text(f'{{"values": [{"null, 1, " * 3000} 1 ]}}')
    assert np.isnan(json_arrays.load(path, "values")["values"]).sum() == 3000
