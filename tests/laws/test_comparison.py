"""Comparisons: calibrated on noise of known size, and firm on models that are wrong."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr
from synthetic import GRID, TRUTH, external, poisson, synthetic

from gonio.brdf import BRDF
from gonio.comparison import ENOUGH_COUNT, Comparison, compare
from gonio.comparison.pooling import first_bins
from gonio.detectors import Apertures, HemisphereGrid
from gonio.models import CookTorrance, Lambert, Ward
from gonio.optics import Conductor, Mirror
from gonio.sphere import direction

# --- Noise is called noise --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_calibrated_on_pure_noise():
    """In 200 repeats: z is Student's t, 5 % of bins are outside, L1 is what noise adds up to, nothing is found."""
    from scipy.stats import kstest

    tables = [compare(synthetic(seed=seed), TRUTH).table for seed in range(200)]
    column = {name: np.array([table[name].item() for table in tables]) for name in tables[0]}
    assert kstest(column["p_value"], "uniform").pvalue > 0.01
    share = column["share_outside"]
    assert share.mean() == pytest.approx(0.05, abs=4 * share.std() / np.sqrt(share.size))
    for metric in ("l1", "l2", "log_rms"):
        ratio = column[metric] / column[f"{metric}_noise"]
        # Squares and logarithms of noise are not straight: 0.5 % is what 2 % of noise bends them by.
        assert ratio.mean() == pytest.approx(1.0, abs=4 * ratio.std() / np.sqrt(ratio.size) + 0.005)
    for metric in ("reduced_chi2", "reduced_chi2_mc"):
        spread = column[metric].std() / np.sqrt(ratio.size)
        assert column[metric].mean() == pytest.approx(1.0, abs=4 * spread)
    # 5 % of the albedos differ by construction: 10 of 200, with a standard deviation of 3.1.
    assert 1 <= column["albedo_significant"].sum() <= 20
    assert (column["lobe"] == "consistent").mean() > 0.98


@pytest.mark.slow
def test_many_cells_are_one_family():
    """With 12 incidences and wavelengths a comparison finds something in 5 % of cases, not in half of them."""
    conditions = {"theta_i": (0.0, 30.0, 60.0), "phi_i": (0.0, 90.0), "wavelengths": (450.0, 650.0)}
    detector = HemisphereGrid(15.0, 30.0)
    found = [
        bool(compare(synthetic(seed=seed, detector=detector, **conditions), TRUTH).table["albedo_significant"].any())
        for seed in range(60)
    ]
    assert sum(found) <= 9  # 3 expected


def test_pooled_bins_leave_five_per_cent_outside_too():
    """Counts of a few, each of which carries the same energy: Poisson noise, pooled to a count of at least 10."""
    outside, bins = [], []
    for seed in range(60):
        measurement = poisson(seed, photons=3000)
        row = compare(measurement, TRUTH).table
        outside.append(row["share_outside"].item() * row["bins"].item())
        bins.append(row["bins"].item())
        assert row["bins"].item() < GRID.bins
        assert row["lobe"].item() == "consistent"
    # A count of 10 is skewed, and knows its own error the worse the smaller it is: 5 % become up to 8 %.
    assert 0.03 < sum(outside) / sum(bins) < 0.085


def test_specimens_that_shift_a_whole_lobe_are_not_mistaken_for_a_wrong_model():
    comparisons = [compare(synthetic(seed=seed, realisations=4, noise=1e-3, common=0.02), TRUTH) for seed in range(60)]
    lobes = [comparison.table["lobe"].item() for comparison in comparisons]
    assert lobes.count("significant") <= 9  # 3 expected at most
    assert all(comparison.scope == "ensemble" for comparison in comparisons)
    assert "4 specimens were measured" in comparisons[0].sentences()[0]
    assert comparisons[0].table["l1_noise_mc"].item() < 0.2 * comparisons[0].table["l1_noise"].item()


# --- Differences are called differences -------------------------------------------------------------------------------


def test_a_wrong_model_is_rejected_in_numbers_and_in_words():
    wrong = CookTorrance(m=0.4, material=Mirror())
    comparison = compare(synthetic(noise=0.01), wrong)
    row = comparison.table.isel(theta_i=0, phi_i=0, wavelength=0)
    assert row["albedo_significant"]
    assert row["lobe"] == "significant"
    assert row["share_outside"] > 0.2
    exact = (TRUTH.average(direction(30.0), GRID)[:, 0], wrong.average(direction(30.0), GRID)[:, 0])
    solid = GRID.projected_solid_angles()
    l1 = np.abs(exact[0] - exact[1]) @ solid / (exact[1] @ solid)
    assert l1 <= row["l1"] < l1 + row["l1_noise"]
    assert row["albedo_model"] == pytest.approx(exact[1] @ solid, rel=1e-12)
    scope, albedo, lobe = comparison.sentences()
    assert comparison.scope == "specimen"
    assert "speaks of that specimen only" in scope
    relative = 100 * (row["albedo_model"] / row["albedo_measured"] - 1).item()
    assert albedo.startswith(f"theta_i 30: order-1 albedo {row['albedo_measured'].item():.5f} ± ")
    assert f"CookTorrance {row['albedo_model'].item():.5f}: {abs(relative):.2g} % lower, " in albedo
    assert " degrees of freedom, p = " in albedo
    assert albedo.endswith(": significant beyond noise.")
    assert lobe.startswith(f"theta_i 30: the lobe differs by {100 * row['l1'].item():.2g} % (L1), of which noise alone")
    assert lobe.endswith(": significant beyond noise.")


def test_a_right_albedo_with_a_wrong_lobe_is_rejected_by_the_lobe_only():
    gray = Lambert(float((TRUTH.average(direction(30.0), GRID)[:, 0] * GRID.projected_solid_angles()).sum()))
    row = compare(synthetic(), gray).table.isel(theta_i=0, phi_i=0, wavelength=0)
    assert not row["albedo_significant"]
    assert row["lobe"] == "significant"


def test_without_noise_an_exact_model_agrees_and_any_other_does_not():
    measurement = synthetic(truth=Lambert(0.5), noise=0.0)
    exact, other = (compare(measurement, Lambert(rho)).table.squeeze() for rho in (0.5, 0.501))
    assert not exact["albedo_significant"]
    assert exact["lobe"] == "consistent"
    assert other["albedo_significant"]
    assert other["lobe"] == "significant"
    assert all("nan" not in sentence for sentence in compare(measurement, Lambert(0.5)).sentences())


def test_every_column_is_documented():
    """The names in the docstring of a comparison are those of its table, of its bins and of its attributes."""
    comparison = compare(synthetic(), TRUTH)
    columns = {str(name) for data in (comparison.table, comparison.lobes) for name in data.data_vars}
    documented = set(re.findall(r"`(\w+)`", Comparison.__doc__))
    assert documented - columns == {"table", "lobes", "compare", "relative_threshold"}
    assert columns <= documented


def test_a_model_without_light_is_told_apart_from_a_black_surface():
    black = synthetic(truth=Lambert(0.0), noise=0.0)
    with np.errstate(all="raise"):
        row = compare(black, Lambert(0.5)).table.squeeze()
        assert row["albedo_significant"]
        assert "nothing was measured" in compare(black, Lambert(0.5)).sentences()[1]
        assert not compare(black, Lambert(0.0)).table.squeeze()["albedo_significant"]


# --- Metrics ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.25])
def test_a_model_that_is_off_by_a_factor(factor):
    """Measured = factor x model: every metric is a closed form of the factor."""
    measurement = synthetic(truth=Lambert(0.6 * factor), noise=0.0)
    row = compare(measurement, Lambert(0.6)).table.squeeze()
    for metric in ("l1", "l2"):
        assert row[metric].item() == pytest.approx(abs(factor - 1), abs=1e-12)
    assert row["log_rms"].item() == pytest.approx(abs(np.log(factor)), abs=1e-12)
    assert row["albedo_bias"].item() == pytest.approx(1 / factor - 1, abs=1e-12)


def test_a_gradient_has_its_own_norms():
    """Against f = 1 / pi, cos theta times f: integrals over the hemisphere are polynomials of the cosine."""
    fine = HemisphereGrid(1.0, 30.0)
    measurement = synthetic(truth=Lambert(1.0), noise=0.0, detector=fine)
    edges = np.cos(np.radians(fine.theta_edges))
    cosine = -np.diff(edges**3) / 3 / (-np.diff(edges**2) / 2)  # the bins' own averages
    measurement.dataset["brdf"] *= xr.DataArray(cosine, dims="theta_o")
    row = compare(measurement, Lambert(1.0)).table.squeeze()
    assert row["l1"].item() == pytest.approx(1 / 3, rel=1e-4)  # 1 - 2/3
    assert row["l2"].item() == pytest.approx(np.sqrt(1 - 4 / 3 + 1 / 2), rel=1e-3)
    # Above a threshold of a half: theta below 60 degrees.
    row = compare(measurement, Lambert(1.0), relative_threshold=0.5).table.squeeze()
    u = np.linspace(0.5, 1, 100_001)
    exact = np.sqrt(np.average(np.log(u) ** 2, weights=u))
    assert row["log_rms"].item() == pytest.approx(exact, rel=0.02)


def test_the_significance_map_has_every_bin_and_the_worst_ones_are_named():
    measurement = synthetic(noise=1e-3, theta_i=(0.0, 30.0), wavelengths=(450.0, 650.0))
    spot = {"theta_i": 1, "phi_i": 0, "theta_o": 7, "dphi": 11, "wavelength": 1}
    measurement.dataset["brdf"][{"order": 0, **spot}] *= 1.1
    comparison = compare(measurement, TRUTH)
    lobes = comparison.lobes
    assert lobes["significance"].dims == ("theta_i", "phi_i", "theta_o", "dphi", "wavelength")
    assert lobes["significance"].shape == (2, 1, *GRID.shape, 2)
    here = lobes.isel(spot)
    expected = (here["measured"] - here["model"]) / np.hypot(here["standard_error"], 1e-5 * here["model"])
    assert here["significance"].item() == pytest.approx(expected.item(), rel=1e-9)
    assert here["significance"].item() > 30
    rest = lobes["significance"].where(lobes["significance"] < here["significance"])
    assert rest.std().item() == pytest.approx(np.sqrt(15 / 13), rel=0.1)  # Student's t with 15
    worst = comparison.worst_bins(3)
    assert (worst[0]["theta_i"], worst[0]["theta_o"], worst[0]["dphi"], worst[0]["wavelength"]) == (
        30.0,
        GRID.theta[7],
        GRID.dphi[11],
        650.0,
    )
    assert worst[0]["measured"] / worst[0]["model"] == pytest.approx(1.1, rel=0.01)
    assert worst[0]["share"] > worst[-1]["share"]


def test_sparse_bins_share_the_significance_of_their_pool():
    comparison = compare(poisson(1, photons=3000), TRUTH)
    significance = comparison.lobes["significance"].values.ravel()
    assert np.isfinite(significance).all()
    assert np.count_nonzero(np.diff(significance)) == comparison.table["bins"].item() - 1


def test_the_words_say_which_noise_it_is():
    specimens = [compare(synthetic(seed=seed, realisations=8, noise=1e-4, common=0.02), TRUTH) for seed in range(5)]
    words = [sentence for comparison in specimens for sentence in comparison.sentences()[1:]]
    assert (
        sum(
            "consistent with how specimens differ, though not with Monte Carlo noise alone" in sentence
            for sentence in words
        )
        >= 3
    )
    assert compare(synthetic(), TRUTH).sentences()[2].endswith(": consistent with Monte Carlo noise.")


@dataclass(frozen=True)
class Walk:
    """A model that is known with a relative error only."""

    error: float
    order = "1"

    def estimate(self, wi, detector, wavelengths, orders):
        rng = np.random.default_rng(1)
        exact = TRUTH.average(wi, detector, wavelengths)
        value = exact * (1 + self.error * rng.standard_normal(exact.shape))
        return np.stack([value] * (orders + 1)), np.stack([self.error * exact] * (orders + 1))

    def albedo(self, wi, wavelengths, orders):
        exact = TRUTH.average(wi, GRID, wavelengths).T @ GRID.projected_solid_angles()
        return np.stack([exact] * (orders + 1)), np.stack([self.error * exact] * (orders + 1))


def test_what_a_random_walk_does_not_know_is_noise_too():
    row = compare(synthetic(noise=1e-4), Walk(error=0.02)).table.squeeze()
    assert row["lobe"] == "consistent"
    assert row["reduced_chi2"].item() == pytest.approx(1.0, abs=0.25)


# --- Shapes -----------------------------------------------------------------------------------------------------------


def test_incidences_that_were_not_measured_are_left_out():
    comparison = compare(synthetic(theta_i=(0.0, 30.0), phi_i=(0.0, 90.0), skip=((1, 0),)), TRUTH)
    assert comparison.table["albedo_measured"].isnull().sum() == 1
    assert comparison.table["bins"].values.ravel().tolist() == [GRID.bins, GRID.bins, 0, GRID.bins]
    assert comparison.table["lobe"].values[1, 0, 0] == ""
    assert len(comparison.sentences()) == 1 + 2 * 3
    assert not any(sentence.startswith("theta_i 30, phi_i 0:") for sentence in comparison.sentences())
    with pytest.raises(ValueError, match="no measured incidence"):
        compare(synthetic(skip=((0, 0),)), TRUTH)


def test_every_wavelength_has_its_row_and_the_worst_is_told():
    gold = CookTorrance(m=0.4, material=Conductor("Au"))
    blue = CookTorrance(m=0.4, material=Conductor(eta=1.38, k=1.92))  # gold as it is at 450 nm
    comparison = compare(synthetic(truth=gold, wavelengths=(450.0, 650.0)), blue)
    assert comparison.table["lobe"].values.ravel().tolist() == ["consistent", "significant"]
    assert comparison.sentences()[1].startswith("theta_i 30, 650 nm: order-1 albedo")


def test_apertures_are_compared_and_the_albedo_is_that_of_the_hemisphere():
    detector = Apertures(directions=((30.0, 180.0), (35.0, 180.0), (60.0, 100.0)), half_angle=2.0)
    measurement = synthetic(detector=detector, noise=1e-3)
    hemisphere = synthetic(noise=1e-3)
    for name in ("albedo", "albedo_standard_error", "albedo_standard_error_mc"):
        measurement.dataset[name] = hemisphere.dataset[name]
    row = compare(measurement, TRUTH).table.squeeze()
    assert row["bins"] == 3
    assert row["lobe"] == "consistent"
    exact = TRUTH.average(direction(30.0), GRID)[:, 0] @ GRID.projected_solid_angles()
    assert row["albedo_model"] == pytest.approx(exact, rel=2e-5)
    assert compare(measurement, CookTorrance(m=0.3, material=Mirror())).table.squeeze()["lobe"] == "significant"


def test_a_wide_beam_is_mentioned():
    assert "half angle of 2.5 degrees" in compare(synthetic(beam=2.5), TRUTH).sentences()[1]


def test_pools_are_neighbours_with_enough_arrivals_and_lose_nothing():
    rng = np.random.default_rng(3)
    for count in (rng.poisson(2.0, 500), np.zeros(7, int), np.array([100]), np.array([9, 1, 10, 3, 30, 2])):
        energy = count[:, None].astype(float)
        first = first_bins(count, energy, energy)
        pooled = np.add.reduceat(count, first)
        assert first[0] == 0
        assert (np.diff(first) > 0).all()
        assert pooled.sum() == count.sum()
        assert (pooled >= min(ENOUGH_COUNT, count.sum())).all()
    count = np.array([9, 1, 10, 3, 30, 2])
    energy = count[:, None] * np.array([0.5, 1.0])
    assert first_bins(count, energy, energy**2 / count[:, None]).tolist() == [0, 2, 3]
    # Arrivals that come in clusters of three: 30 are worth 10.
    assert first_bins(count, energy, 3 * energy**2 / count[:, None]).tolist() == [0]


# --- Conclusions ------------------------------------------------------------------------------------------------------


def test_the_conclusion_says_below_which_noise_or_how_large_the_difference_is():
    right = compare(synthetic(seed=1), TRUTH).conclusion()
    assert right.startswith("the difference is consistent with Monte Carlo noise, which is up to ")
    shifted = (synthetic(seed=seed, realisations=8, noise=1e-4, common=0.02) for seed in range(12))
    words = " ".join(compare(measurement, TRUTH).conclusion() for measurement in shifted)
    assert "consistent with the noise of specimens, though not with Monte Carlo noise alone, which is up to" in words
    assert "inconclusive: specimens differ too much to tell" in words
    wrong = compare(synthetic(seed=1, noise=1e-3, theta_i=(0.0, 60.0)), CookTorrance(m=0.4, material=Mirror()))
    assert wrong.conclusion().startswith("the difference is significant beyond noise at 2 of 2 incidences")
    row = wrong.worst_rows()[1]
    assert f"off by up to {row['albedo_bias']:+.2%}" in wrong.conclusion() or "(theta_i 0" in wrong.conclusion()
    assert "(L1) beyond noise" in wrong.conclusion()


def test_a_comparison_is_a_file(tmp_path):
    comparison = compare(synthetic(seed=1, wavelengths=(450.0, 650.0)), TRUTH)
    path = comparison.save(tmp_path / "comparison.nc")
    with xr.open_dataset(path, engine="h5netcdf", group="table") as table:
        np.testing.assert_array_equal(table["l1"], comparison.table["l1"])
        np.testing.assert_array_equal(table["albedo_significant"], comparison.table["albedo_significant"])
        assert table.attrs["model"] == repr(TRUTH)
        assert table.attrs["relative_threshold"] == 0.01
    with xr.open_dataset(path, engine="h5netcdf", group="lobes") as lobes:
        xr.testing.assert_equal(lobes["significance"], comparison.lobes["significance"])
        assert lobes["measured"].attrs["units"] == "sr-1"


# --- External measurements --------------------------------------------------------------------------------------------

OF_NOISE = (
    "z",
    "p_value",
    "l1_noise",
    "l2_noise",
    "log_rms_noise",
    "reduced_chi2",
    "share_outside",
    "share_noise_expected",
)
WRONG = CookTorrance(m=0.4, material=Mirror())


def test_without_errors_differences_are_told_but_nothing_of_noise():
    """A table of a model's own averages is that model; against another it differs as it does without noise."""
    exact, wrong = (compare(external(theta_i=(0.0, 60.0)), model) for model in (TRUTH, WRONG))
    for metric in ("albedo_bias", "l1", "l2", "log_rms"):
        np.testing.assert_allclose(exact.table[metric], 0.0, atol=1e-12)
        there = compare(synthetic(noise=0.0, theta_i=(0.0, 60.0)), WRONG).table[metric]
        np.testing.assert_allclose(wrong.table[metric], there, rtol=1e-9)
    for comparison in (exact, wrong):
        assert all(comparison.table[name].isnull().all() for name in OF_NOISE)
        assert (comparison.table["lobe"] == "unknown").all()
        assert not comparison.table["albedo_significant"].any()
        assert comparison.lobes["significance"].isnull().all()
        assert not comparison.worst_bins()
        assert "consistent with noise is unknown" in comparison.sentences()[0]
        words = " ".join([*comparison.sentences(), comparison.conclusion()])
        assert "nan" not in words
    row = wrong.worst_rows()[0]
    assert wrong.conclusion().startswith("whether the difference is consistent with noise is unknown")
    assert f"its albedo is off by up to {row['albedo_bias']:+.2%} (theta_i 0, 550 nm)" in wrong.conclusion()
    assert "the lobe differs by" in wrong.sentences()[-1]


@pytest.mark.slow
def test_errors_of_a_file_are_calibrated():
    """In 200 repeats z is normal, 5 % of bins are outside, chi² is 1 and L1 what noise adds up to; nothing is found."""
    from scipy.stats import kstest

    tables = [compare(external(noise=0.02, seed=seed), TRUTH).table for seed in range(200)]
    column = {name: np.array([table[name].item() for table in tables]) for name in tables[0]}
    assert kstest(column["z"], "norm").pvalue > 0.01
    for name, expected in {"share_outside": 0.05, "reduced_chi2": 1.0}.items():
        spread = column[name].std() / np.sqrt(200)
        assert column[name].mean() == pytest.approx(expected, abs=4 * spread)
    for metric in ("l1", "l2", "log_rms"):
        ratio = column[metric] / column[f"{metric}_noise"]
        assert ratio.mean() == pytest.approx(1.0, abs=4 * ratio.std() / np.sqrt(200) + 0.005)
    assert 1 <= column["albedo_significant"].sum() <= 20  # 10 expected
    assert (column["lobe"] == "consistent").mean() > 0.98
    assert (column["bins"] == GRID.bins).all()
    assert np.isinf(column["degrees_of_freedom"]).all()


def test_with_errors_noise_is_called_noise_and_differences_differences():
    measurement = external(noise=0.01, seed=1)
    right, wrong = compare(measurement, TRUTH), compare(measurement, WRONG)
    assert right.scope == "external"
    assert right.sentences()[0].startswith("The measurement is external: its errors are those in its file")
    assert right.conclusion().startswith(
        "the difference is consistent with the noise that its file tells, which is up to "
    )
    albedo, lobe = right.sentences()[-2:]
    assert "degrees of freedom" not in albedo
    assert f"z = {right.table['z'].item():.3g}, p = " in albedo
    assert albedo.endswith(": consistent with the errors of the file.")
    assert lobe.endswith(": consistent with the errors of the file.")
    assert f"of {GRID.bins} bins are outside" in lobe
    assert wrong.table["albedo_significant"].item()
    assert wrong.table["lobe"].item() == "significant"
    assert wrong.conclusion().startswith("the difference is significant beyond noise at 1 of 1 incidences")
    assert wrong.worst_bins()[0]["channel"] == "550 nm"
    assert not any("Monte Carlo" in sentence or "specimen" in sentence for sentence in right.sentences())


def test_a_model_of_one_hit_is_held_against_all_light_and_says_so():
    comparison = compare(external(), TRUTH)
    assert comparison.order == "all"
    assert "Microfacet, which speaks of the light of one hit, was compared with all of it" in comparison.preamble()[1]
    of_all = compare(external(truth=Ward(alpha=0.3)), Ward(alpha=0.3))
    assert len(of_all.preamble()) == 1
    with pytest.raises(ValueError, match="the measurement has no order '1', only 2"):
        compare(synthetic(order="2"), TRUTH)


def test_bins_that_are_not_known_take_no_part():
    """A hole at one wavelength: the others do not change, and what is left is that model, or another."""
    hole = np.zeros((1, 1, *GRID.shape, 2), bool)
    hole[..., 10:, 5:9, 1] = True
    options = {"noise": 0.02, "seed": 3, "wavelengths": (450.0, 650.0)}
    whole, part = (compare(external(unknown=unknown, **options), TRUTH).table.squeeze() for unknown in (None, hole))
    for name in whole:
        assert part[name][0].item() == (
            whole[name][0].item() if name == "lobe" else pytest.approx(whole[name][0].item())
        )
    assert part["bins"].values.tolist() == [GRID.bins, GRID.bins - hole.sum()]
    assert part["lobe"][1] == "consistent"
    assert abs(part["z"][1]) < 4
    solid = np.where(hole[0, 0, ..., 1].ravel(), 0.0, GRID.projected_solid_angles())
    exact = TRUTH.average(direction(30.0), GRID)[:, 0] @ solid
    assert part["albedo_model"][1].item() == pytest.approx(exact, rel=1e-12)
    comparison = compare(external(unknown=hole, wavelengths=(450.0, 650.0)), WRONG)
    bias = comparison.table["albedo_bias"].values.ravel()
    assert bias[1] != pytest.approx(bias[0])
    assert f"The file knows nothing of 0 to {hole.sum()} of the {GRID.bins} bins" in comparison.preamble()[-1]
    assert np.isnan(comparison.lobes["measured"].values[hole]).all()


def test_what_is_not_known_at_all_has_no_row():
    nothing = np.zeros((2, 1, 1, 1, 2), bool)
    nothing[1, ..., 0] = True
    comparison = compare(external(theta_i=(0.0, 30.0), wavelengths=(450.0, 650.0), unknown=nothing), TRUTH)
    assert [(row["theta_i"], row["channel"]) for row in comparison.rows()] == [
        (0.0, "450 nm"),
        (0.0, "650 nm"),
        (30.0, "650 nm"),
    ]
    assert len(comparison.worst_rows()) == 2
    with pytest.raises(ValueError, match="no measured incidence"):
        compare(external(unknown=True), TRUTH)


def test_errors_that_are_known_in_part_are_no_errors_where_they_are_not():
    measurement = external(noise=0.02, wavelengths=(450.0, 650.0))
    measurement.dataset["brdf_standard_error"][..., 3, 3, 0] = np.nan
    measurement.dataset["albedo_standard_error"][..., 0] = np.nan
    comparison = compare(measurement, TRUTH)
    assert comparison.table["lobe"].values.ravel().tolist() == ["unknown", "consistent"]
    assert "no errors of some incidences or wavelengths" in comparison.preamble()[0]
    assert np.isnan(comparison.lobes["significance"]).sum() == 1


def test_a_model_sampled_as_a_function_is_that_model():
    """Two nodes an axis and bin against the averages that are exact to 1e-5."""
    lobes = BRDF(lambda wi, wo: TRUTH.eval(wi, wo, (550.0,)), np.array([550.0]), np.array([0.0, 30.0]))
    comparison = compare(lobes.sampled((0.0, 30.0), 0.0, GRID, nodes=6), TRUTH)
    np.testing.assert_allclose(comparison.table["albedo_bias"], 0.0, atol=2e-5)
    np.testing.assert_allclose(comparison.table["l1"], 0.0, atol=2e-5)


def test_channels_of_a_colour_have_names():
    attributes = {"basis": "RGB"}
    comparison = compare(external(noise=0.01, wavelengths=(611.4, 549.1, 464.2), attributes=attributes), WRONG)
    assert {row["channel"] for row in comparison.rows()} == {"R", "G", "B"}
    words = " ".join([*comparison.sentences(), comparison.conclusion()])
    assert "nm" not in words
    assert comparison.sentences()[-1].startswith(f"theta_i 30, {comparison.worst_rows()[0]['channel']}: ")


def test_a_comparison_without_errors_is_a_file(tmp_path):
    path = compare(external(), WRONG).save(tmp_path / "comparison.nc")
    with xr.open_dataset(path, engine="h5netcdf", group="table") as table:
        assert table.attrs["scope"] == "external"
        assert table.attrs["channels"] == "550 nm"
        assert np.isnan(table["p_value"]).all()


def test_a_model_in_any_clothes_is_judged_alike():
    """A closed form, the same as a Python function, and a table of it."""
    measurement = synthetic(noise=0.02, seed=5, wavelengths=(450.0, 650.0))
    themselves = compare(measurement, TRUTH).table
    written = compare(measurement, BRDF.of(TRUTH, measurement.wavelengths)).table
    for name in ("l1", "reduced_chi2", "albedo_model", "z"):
        np.testing.assert_allclose(themselves[name], written[name], rtol=1e-12)
    measurement = external(wavelengths=(450.0, 650.0))
    function = compare(measurement, lambda wi, wo: TRUTH.eval(wi, wo, measurement.wavelengths)).table
    np.testing.assert_allclose(function["albedo_model"], compare(measurement, TRUTH).table["albedo_model"], rtol=1e-2)
