"""CSV: tables of others, and what spreadsheets see."""

import dataclasses

import numpy as np
import pandas
import pytest
from closed_forms import GRID, THETA_I, WAVELENGTHS, isotropic, measured

from gonio.brdf import BRDF
from gonio.formats import table_csv
from gonio.sphere import direction


def test_pandas_reads_the_csv_with_its_column_names(tmp_path):
    path = tmp_path / "lobe.csv"
    brdf = isotropic()
    assert not table_csv.write(brdf, path)
    frame = pandas.read_csv(path, comment="#")
    assert list(frame) == [*table_csv.COLUMNS]
    wide = frame.set_index(["theta_i", "phi_i", "theta_o", "dphi", "wavelength"])
    for name in ("brdf", "brdf_standard_error"):
        ours = brdf.measured().dataset[name].sel(order="all")
        # Before pandas 3.1 its numbers are those of the file to eleven digits.
        np.testing.assert_allclose(wide[name].to_xarray().transpose(*ours.dims), ours, rtol=1e-11)


def test_the_csv_has_the_counts_and_tells_where_it_came_from(tmp_path):
    path = tmp_path / "lobe.csv"
    source = measured()
    count = np.arange(len(THETA_I) * GRID.bins).reshape(1, len(THETA_I), 1, *GRID.shape)
    dims = ("order", "theta_i", "phi_i", "theta_o", "dphi")
    counted = dataclasses.replace(source, external=source.external.assign(count=(dims, count)))
    about = dataclasses.replace(
        counted, attributes={**source.attributes, "title": "two\nlines", "experiment": '{"seed": 7}'}
    )
    table_csv.write(BRDF.of(about), path)
    frame = pandas.read_csv(path, comment="#")
    np.testing.assert_array_equal(frame["count"], np.repeat(count.ravel(), len(WAVELENGTHS)))
    back = table_csv.read(path)
    assert (back.title, back.attributes["experiment"]) == ("two lines", '{"seed": 7}')
    assert path.read_text().startswith("# two lines\n")


@pytest.mark.parametrize(
    "text",
    [
        "brdf, theta_o ,THETA_I,dphi\n0.3,0,30,0\n0.4,20,30,0\n0.3,0,30,180\n0.6,20,30,180\n",
        "theta_i;phi_o;theta_o;brdf;note\r\n30,0;0;0;0,3;a\r\n30;0;20;4e-1;b\r\n30;180;0;0,3;\r\n30;180;20;0,6;c\r\n",
        "# by hand\n\n#\ntheta_i\tphi_i\tphi_o\ttheta_o\tbrdf\n30\t90\t90\t0\t.3\n30\t90\t90\t20\t.4\n"
        "30\t90\t-90\t20\t.6\n30\t90\t270\t0\t.3\n",
        "\ufefftheta_i,dphi,theta_o,brdf,wavelength\n30,180,20,.6,500\n30,180,0,.3,500\n30,0,20,.4,500\n30,0,0,.3,500",
        "theta_i,dphi,theta_o,brdf,brdf_standard_error\n30,180,20,.6,.1\n30,180,0,.3,\n30,0,20,.4,\n30,0,0,.3,.2",
    ],
)
def test_other_peoples_csv(text, tmp_path):
    path = tmp_path / "theirs.csv"
    path.write_bytes(text.encode())
    brdf = table_csv.read(path)
    assert brdf.isotropic
    assert brdf.basis == ("spectrum" if "wavelength" in text else "Y")
    found = brdf.evaluate(direction(np.full(3, 30.0), 77.0), direction([10.0, 15.0, 20.0], [77.0, 257.0, 257.0]))
    np.testing.assert_allclose(found[:, 0], [0.35, 0.525, 0.6], rtol=1e-9)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("theta_i,theta_o,brdf\n30,20,1\n", "dphi or phi_o are missing"),
        ("a,b\n1,2\n", "theta_i, theta_o, brdf, dphi or phi_o are missing"),
        ("theta_i,dphi,theta_o,brdf\n", "holds no values"),
        ("theta_i,dphi,theta_o,brdf\n30,0,much,1\n", "much"),
        ("theta_i,dphi,theta_o,brdf\n30,0,,1\n", "missing or no number"),
        ("theta_i,dphi,theta_o,brdf,wavelength\n30,0,1,1,-5\n", "wavelength = -5 must be positive"),
    ],
)
def test_what_is_wrong_with_a_csv_is_said(text, complaint, tmp_path):
    path = tmp_path / "theirs.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=complaint):
        table_csv.read(path)


def test_more_rows_than_a_spreadsheet_shows_are_noted(monkeypatch, tmp_path):
    monkeypatch.setattr(table_csv, "EXCEL_ROWS", 2160)
    assert "2160 rows" in table_csv.write(isotropic(), tmp_path / "long.csv")[0]
