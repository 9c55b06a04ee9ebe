"""What a campaign becomes: one array read from many files, and a data set that others can check and use."""

from __future__ import annotations

import csv
import hashlib
import json
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import gonio
import microsurfaces as ms
from gonio.campaign import dataset, results, running
from gonio.campaign.dataset import Layout, open_campaign
from gonio.campaign.publication import About, publish
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.experiment import Experiment
from gonio.toml_files import InputError

TINY = gonio.Goniometer(
    theta_i=(0.0, 30.0), paths=2000, replicates=4, wavelengths=(450.0, 650.0),
    detector=gonio.HemisphereGrid(theta_step=18.0, phi_step=30.0),
)  # fmt: skip
ALPHAS, METALS = (0.2, 0.3), ("Au", "Al")
ABOUT = About("Toys & more", ("Muster, Maxi", "Doe, Jane"), "CC-BY-4.0", "Small patches of <rough> metal.")


def rough(alpha, **options):
    return ms.Gaussian(alpha=alpha, side=100.0, samples=32, **options)


def crossed():
    experiments = [
        Experiment(rough(alpha), gonio.Conductor(metal), TINY, realisations=2) for alpha in ALPHAS for metal in METALS
    ]
    return Campaign.of(experiments, "Toys")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A campaign of 2 roughnesses and 2 metals, merged; not to be changed."""
    path = tmp_path_factory.mktemp("finished")
    running.run(crossed(), path)
    results.merge(path)
    return path


@pytest.fixture(scope="module")
def published(finished, tmp_path_factory):
    return publish(finished, tmp_path_factory.mktemp("published") / "toys", ABOUT)


# --- One array -------------------------------------------------------------------------------------------------------


def test_every_value_is_that_of_its_file(finished):
    data = open_campaign(finished)
    assert data.brdf.dims[:3] == ("surface_alpha", "material_name", "order")
    assert data["surface_alpha"].attrs["long_name"] == "surface.alpha"
    assert data.attrs["title"] == "Toys"
    files = sorted((finished / "measurements").glob("*.nc"))
    for number, (alpha, metal) in enumerate((alpha, metal) for alpha in ALPHAS for metal in METALS):
        part = data.sel(surface_alpha=alpha, material_name=metal)
        assert int(part["experiment"]) == number + 1
        single = gonio.load(files[number])
        assert json.loads(single.attributes["experiment"])["surface"]["alpha"] == alpha
        for name, variable in single.dataset.variables.items():
            np.testing.assert_array_equal(part[name].values, variable.values)
            assert part[name].dtype == variable.dtype or name == "order"
            assert part[name].attrs.get("units") == variable.attrs.get("units")


def test_only_what_is_asked_for_is_read(finished, monkeypatch):
    opened = []

    class Spy(h5py.File):
        def __init__(self, path, *args):
            opened.append(Path(path).name)
            super().__init__(path, *args)

    data = open_campaign(finished)
    monkeypatch.setattr(h5py, "File", Spy)
    chosen = data.brdf.sel(surface_alpha=0.3).isel(material_name=1)
    assert opened == []
    assert np.isfinite(chosen.values).all()
    assert [name[:4] for name in opened] == ["0004"]


KEYS = [
    {"surface_alpha": 1},
    {"surface_alpha": [1, 0], "wavelength": [1, 0, 1]},
    {"theta_o": slice(None, None, -1), "material_name": slice(1, None)},
    {"dphi": slice(1, -1, 3), "order": [0], "theta_i": slice(0, 0)},
    {"surface_alpha": [], "phi_i": 0},
    {"surface_alpha": np.array([0, 0, 1]), "material_name": -1, "theta_o": np.array([3, 1])},
]


@pytest.mark.parametrize("key", KEYS, ids=str)
def test_any_part_is_that_of_the_whole(finished, key):
    data = open_campaign(finished)
    np.testing.assert_array_equal(data.brdf.isel(key).values, open_campaign(finished).brdf.load().isel(key).values)


def test_what_is_not_complete_is_nan_and_counts_nothing(copied):
    unit = CampaignStore(copied).manifest()["experiments"][1]["units"][0]
    (copied / "units" / f"{unit}.npz").unlink()
    for path in (copied / "measurements").glob("*.nc"):
        path.unlink()
    assert results.merge(copied).incomplete == 1
    data = open_campaign(copied)
    missing = np.isnan(data.albedo.sel(order="all")).all(("theta_i", "phi_i", "wavelength"))
    np.testing.assert_array_equal(missing.values, [[False, True], [False, False]])
    assert (data.paths.values[0, 1] == 0).all()
    assert (data.paths.values[1] == 4000).all()


def points(**columns):
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def test_parameters_that_step_together_share_a_dimension():
    zipped = points(a=[1, 1, 2, 2], b=["x", "x", "y", "y"], c=[0.1, 0.2, 0.1, 0.2])
    layout = Layout.of(zipped)
    assert layout.dims == ("a", "c")
    np.testing.assert_array_equal(layout.places, [[0, 1], [2, 3]])
    told = layout.coordinates()
    assert told["b"][0] == ("a",)
    assert list(told["b"][1]) == ["x", "y"]
    np.testing.assert_array_equal(told["experiment"][1], [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    "listed",
    [
        points(a=[0.31, 0.52, 0.11], b=[7, 9, 8], c=["x", "x", "y"]),  # a random design: a settles all others
        points(a=[1, 1, 2], b=[1, 2, 1]),  # a corner is missing
        points(a=[1, 1, 2, 2], b=[1, 1, 2, 3]),  # twice the same
        points(a=[1, 2, 2, 1], b=[1, 2, 2, 1]),
    ],
)
def test_what_is_not_crossed_lies_along_the_experiments(listed):
    layout = Layout.of(listed)
    told = layout.coordinates()
    if len({point["a"] for point in listed}) == len(listed):
        assert layout.dims == ("a",)
    else:
        assert layout.dims == ("experiment",)
    for key in listed[0]:
        assert told[key][0] == layout.dims
        assert list(told[key][1]) == [point[key] for point in listed]


def test_parameters_of_any_kind_are_coordinates():
    kinds = [{"kind": "Flat"}, {"kind": "Conductor", "name": "Au"}]
    told = Layout.of(points(a=kinds, b=[None, 2], c=[True, False], d=["p", None]))
    values = {name: list(column) for name, (_, column, _) in told.coordinates().items()}
    assert values["a"] == ["Flat()", "Conductor(name='Au')"]
    np.testing.assert_array_equal(values["b"], [np.nan, 2])
    assert values["c"] == ["true", "false"]
    assert values["d"] == ["p", ""]
    assert Layout.of([{}]).dims == ("experiment",)


def test_what_one_array_cannot_hold_is_refused(tmp_path):
    others = [Experiment(rough(0.3), gonio.Mirror(), replace(TINY, theta_i=(theta,))) for theta in (0.0, 30.0)]
    running.run(Campaign.of(others), tmp_path / "c")
    results.merge(tmp_path / "c")
    with pytest.raises(InputError, match=r"goniometer\.theta_i differs between experiments"):
        open_campaign(tmp_path / "c")
    publish(tmp_path / "c", tmp_path / "many", ABOUT)
    with pytest.raises(InputError, match="differs"):
        publish(tmp_path / "c", tmp_path / "one", ABOUT, single=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c", "many"]


def test_a_folder_without_measurements_says_what_to_do(copied, tmp_path):
    shutil.rmtree(copied / "measurements")
    with pytest.raises(InputError, match="gonio campaign merge"):
        open_campaign(copied)
    with pytest.raises(InputError, match="holds no campaign"):
        open_campaign(tmp_path)


# --- A data set ------------------------------------------------------------------------------------------------------


def test_everything_an_archive_wants_is_there(published):
    kinds = {path.relative_to(published).parts[0] for path in published.rglob("*") if path.is_file()}
    assert kinds == {
        "README.md", "SHA256SUMS", "datacite.json", "index.csv", "manifest.json", "measurements", "thumbnails"
    }  # fmt: skip
    rows = list(csv.DictReader((published / "index.csv").read_text().splitlines()))
    assert [(row["surface.alpha"], row["material.name"]) for row in rows] == [
        (str(alpha), metal) for alpha in ALPHAS for metal in METALS
    ]
    for row in rows:
        ET.parse(published / row["thumbnail"])
        measurement = gonio.load(published / row["file"])
        assert measurement.attributes["license"] == "CC-BY-4.0, https://creativecommons.org/licenses/by/4.0/"
        assert measurement.attributes["creator_name"] == "Muster, Maxi; Doe, Jane"
        assert json.loads(measurement.attributes["experiment"])["material"]["name"] == row["material.name"]


def test_the_checksums_are_those_of_all_files(published):
    sums = dict(reversed(line.split("  ")) for line in (published / "SHA256SUMS").read_text().splitlines())
    files = {str(path.relative_to(published)) for path in published.rglob("*") if path.is_file()} - {"SHA256SUMS"}
    assert set(sums) == files
    for name, digest in sums.items():
        assert hashlib.sha256((published / name).read_bytes()).hexdigest() == digest


def test_the_data_cite_record_has_what_a_doi_needs(published):
    record = json.loads((published / "datacite.json").read_text())
    # Mandatory in DataCite's metadata schema 4 (doi:10.14454/g8e5-6293); the identifier comes from the archive.
    for name in ("creators", "titles", "publisher", "publicationYear", "types"):
        assert record[name]
    assert record["titles"] == [{"title": ABOUT.title}]
    assert [creator["name"] for creator in record["creators"]] == list(ABOUT.creators)
    assert record["types"]["resourceTypeGeneral"] == "Dataset"
    assert record["rightsList"][0]["rightsIdentifier"] == "CC-BY-4.0"


def test_what_is_published_opens_as_before(finished, published):
    before, after = open_campaign(finished), open_campaign(published)
    xr.testing.assert_equal(before.load(), after.load())
    assert after.attrs["title"] == ABOUT.title
    assert after.attrs["license"].startswith("CC-BY-4.0")


def test_one_file_holds_the_same(published, finished, tmp_path):
    path = publish(finished, tmp_path / "one", ABOUT, single=True)
    assert not (path / "measurements").exists()
    many, one = open_campaign(published), open_campaign(path)
    xr.testing.assert_equal(many.load(), one.load())
    assert one.attrs["license"].startswith("CC-BY-4.0")
    for name in many.variables:
        assert one[name].attrs.get("units") == many[name].attrs.get("units")
        assert one[name].attrs.get("long_name") == many[name].attrs.get("long_name")
    one.close()


@pytest.mark.needs("netcdf-bin")
def test_the_netcdf_library_itself_reads_the_one_file(finished, tmp_path):
    path = publish(finished, tmp_path / "one", ABOUT, single=True)
    header = subprocess.run(["ncdump", "-h", path / "campaign.nc"], capture_output=True, text=True, check=True).stdout
    assert "brdf(surface_alpha, material_name, order, theta_i, phi_i, theta_o, dphi, wavelength)" in header


def test_the_readme_says_what_it_is_and_its_python_runs(published):
    text = (published / "README.md").read_text()
    assert text.startswith(f"# {ABOUT.title}\n\n{ABOUT.description}\n")
    assert "| surface.alpha | `surface_alpha` | 0.2, 0.3 |" in text
    assert "| `brdf` | order, theta_i, phi_i, theta_o, dphi, wavelength | sr-1 |" in text
    assert "Relative standard error of the bins:" in text
    (program,) = re.findall(r"```python\n(.*?)```", text, flags=re.S)
    done = subprocess.run(
        [sys.executable, "-c", program + "\nprint(float(data.albedo.max()) <= 1)"],
        cwd=published, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout == "True\n"
    for picture in re.findall(r"!\[lobes\]\((.*?)\)", text):
        assert (published / picture).exists()


def test_height_maps_come_along_and_no_path_of_this_machine(tmp_path):
    maps = []
    for number in range(2):
        folder = tmp_path / f"lab{number}"
        folder.mkdir()
        maps.append(folder / "map.npy")
        np.save(maps[-1], rough(0.3).build(seed=number).heights)
    experiments = [
        Experiment(
            ms.HeightFieldFile(path=str(path), pixel_size=3.125, unit="um", periodic="as is"), gonio.Mirror(), TINY
        )
        for path in maps
    ]
    running.run(Campaign.of(experiments), tmp_path / "c")
    path = publish(tmp_path / "c", tmp_path / "out", ABOUT)
    assert [(path / "inputs" / name).read_bytes() for name in ("map.npy", "map-2.npy")] == [
        source.read_bytes() for source in maps
    ]
    for file in path.rglob("*"):
        assert not file.is_file() or str(tmp_path).encode() not in file.read_bytes(), file
    (experiment,) = re.findall(r"```toml\n(.*?)```", (path / "README.md").read_text(), flags=re.S)
    (path / "experiment.toml").write_text(experiment)
    again = Experiment.read(path / "experiment.toml").run()
    np.testing.assert_array_equal(again.dataset["brdf"].values, open_campaign(path).brdf.isel(surface_path=0).values)


def test_nothing_half_made_is_left(finished, copied, tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="exists already"):
        publish(finished, tmp_path / "there", ABOUT)

    def full(*args):
        raise OSError(28, "no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("gonio.campaign.publication._checksums", full)
        with pytest.raises(OSError, match="no space left"):
            publish(finished, tmp_path / "full", ABOUT)
    unit = CampaignStore(copied).manifest()["experiments"][1]["units"][0]
    (copied / "units" / f"{unit}.npz").write_bytes(b"damaged")
    with pytest.raises(InputError, match="1 of 4 experiments lack units"):
        publish(copied, tmp_path / "damaged", ABOUT)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copied", "there"]


# --- The command line ------------------------------------------------------------------------------------------------


def test_publish_from_the_command_line(finished, tmp_path, gonio_campaign):
    target = tmp_path / "toys"
    tokens = ("publish", finished, "-o", target, "--creator", "Muster, Maxi", "--licence", "CC0-1.0")
    assert gonio_campaign(*tokens, "--single") == (0, f"{target}\n", "")
    assert open_campaign(target).attrs["title"] == "Toys"
    code, _, err = gonio_campaign(*tokens)
    assert (code, err) == (2, f"{target} exists already: give another folder; nothing is written over.\n")


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        (("-o", "x", "--licence", "CC0-1.0"), "needs --creator"),
        (("-o", "x", "--creator", "A"), "needs --licence"),
        (("-o", "x", "--creator", "A", "--licence", ""), "--licence is empty"),
        (("-o", "x", "--creator", " ", "--licence", "CC0-1.0"), "--creator is empty"),
        (("-o", "x", "--creator", "A", "--licence", "CC0-1.0", "--singel"), "--singel"),
    ],
)
def test_what_is_missing_is_told_in_a_sentence(finished, gonio_campaign, monkeypatch, tmp_path, tokens, words):
    monkeypatch.chdir(tmp_path)
    code, out, err = gonio_campaign("publish", finished, *tokens)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_merging_advises_against_the_larger_noise(copied, gonio_campaign, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    code, out, _ = gonio_campaign("merge", copied)
    assert code == 0
    assert "All 4 experiments together:" in out
    words = " ".join(out.split())
    assert words.count("because specimens differ") == 4
    assert "realisations = 8" in words


def test_the_loader_is_public():
    assert gonio.open_campaign is dataset.open_campaign
