"""The ground truth holds, in the quick suite; its formulas are checked by themselves; the README tells its outcome."""

import functools
import math
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from gonio.validation import CASES, markdown, summary, validate
from gonio.validation.judging import LEVEL, Case, bounded, judged, pooled, reduced_chi2, t_test
from gonio.validation.unfolding import unfolded
from microsurfaces.atomic_write import atomic_write

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def quick(tmp_path_factory, worker_id):
    """The rows of a case, measured once; processes that run tests side by side share them."""
    home = tmp_path_factory.getbasetemp()
    home = (home if worker_id == "master" else home.parent) / "validated"
    home.mkdir(exist_ok=True)

    @functools.cache
    def rows(name):
        path = home / f"{name}.pickle"
        if not path.exists():
            with atomic_write(path) as scratch:
                scratch.write_bytes(pickle.dumps(validate(True, (name,))))
        return pickle.loads(path.read_bytes())

    return rows


@pytest.mark.parametrize("name", [case.name for case in CASES])
def test_the_ground_truth_holds(name, quick):
    wrong = [row for row in quick(name) if row.outcome == "FAILS"]
    assert not wrong, "\n".join(f"{row.quantity}: {row.measured:.6g} for {row.exact:.6g}" for row in wrong)
    assert all(math.isfinite(row.measured) and row.settings for row in quick(name))


def all_rows(quick):
    """Those of all cases, the last one measured first: another process may be going through them from the front."""
    found = {case.name: quick(case.name) for case in reversed(CASES)}
    return tuple(row for case in CASES for row in found[case.name])


def test_wrong_forms_are_rejected(quick):
    """Normalisations, proportions of grooves, and V-cavities for a Gaussian surface."""
    rejected = [row for row in all_rows(quick) if row.outcome == "rejected as it should be"]
    words = " ".join(row.quantity for row in rejected)
    for form in ("printed_1982", "half", "pi_for_four", "four_for_pi", "true facet area", "equal depth", "V-cavity"):
        assert form in words


def test_the_readme_tells_the_outcome(quick):
    """Rows and outcomes; numbers may differ in their last digits from one processor to another."""
    rows = all_rows(quick)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = re.search(r"<!-- gonio validate --quick -->\n(.*?)<!-- end -->", text, flags=re.S)
    assert told is not None

    def lasting(table):
        head, _, *cells = [line.strip("| ").split(" | ") for line in table.strip().splitlines()]
        return [[row[head.index(name)] for name in ("case", "numbers", "outcome")] for row in cells]

    assert lasting(told[1]) == lasting(summary(rows))


def test_the_full_outcome_is_of_these_cases():
    text = (ROOT / "docs/validation.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.*)$", text, flags=re.M) == [case.name for case in CASES]
    for case in CASES:
        assert " ".join(case.function.__doc__.split()) in text
    assert ", 0 FAIL." in text


# --- Statistics -------------------------------------------------------------------------------------------------------


def outcomes(make, seeds):
    """Share of the seeds in which a case of one finding fails."""
    found = [judged(Case("toy", lambda _, seed=seed: [make(seed)]), True)[0].outcome for seed in range(seeds)]
    return np.mean([outcome == "FAILS" for outcome in found])


def blocks(seed, bins=50, correlation=0.0, shift=0.0):
    """32 blocks of bins that scatter by 1 % about their shares, neighbours correlated."""
    random = np.random.default_rng(seed)
    noise = random.standard_normal((32, bins + 1))
    noise = np.sqrt(1 - correlation) * noise[:, 1:] + np.sqrt(correlation) * noise[:, :-1]
    return (1 + shift + 0.01 * noise) / bins, np.full(bins, 1 / bins)


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_the_level_is_what_it_is_said_to_be(correlation):
    """1000 cases whose law holds: 10 fail by chance, give or take 3."""
    lobes = outcomes(lambda seed: reduced_chi2("lobe", "", *blocks(seed, correlation=correlation)), 1000)
    numbers = outcomes(lambda seed: t_test("number", "", blocks(seed, 1)[0][:, 0], 1.0, 0.0), 1000)
    assert lobes < 2.5 * LEVEL
    assert 0.2 * LEVEL < numbers < 2.2 * LEVEL


def test_a_difference_of_one_standard_error_in_every_bin_is_seen():
    shift = 0.01 / math.sqrt(32)
    assert outcomes(lambda seed: reduced_chi2("lobe", "", *blocks(seed, shift=2 * shift)), 50) == 1.0
    assert outcomes(lambda seed: reduced_chi2("lobe", "", *blocks(seed, shift=2 * shift), holds=False), 50) == 0.0
    assert outcomes(lambda seed: t_test("number", "", blocks(seed, 1, shift=6 * shift)[0][:, 0], 1.0, 0.0), 50) > 0.98


def test_a_bound_is_a_bound():
    for value, outcome in ((1.05, "agrees"), (0.95, "agrees"), (1.2, "FAILS"), (0.8, "FAILS")):
        (row,) = judged(Case("toy", lambda _, value=value: [bounded("number", "", value, 1.0, 0.1)]), True)
        assert row.outcome == outcome


def test_pools_have_enough_paths_and_lose_nothing():
    random = np.random.default_rng(1)
    exact = random.exponential(size=300)
    exact /= exact.sum()
    shares, expected = pooled(exact[None], exact, 10_000)
    np.testing.assert_allclose(shares[0], expected)
    assert expected.sum() == pytest.approx(1.0)
    assert expected.min() * 10_000 >= 320


# --- Exact numbers ----------------------------------------------------------------------------------------------------


def followed(slope, psi, x):
    """Hits of a ray that enters a groove of two mirrors at -1 < x < 1, walked wall by wall in two dimensions."""
    position, step, hits = np.array([x, 0.0]), np.array([-math.sin(psi), -math.cos(psi)]), 0
    while True:
        reach = []
        for side in (1.0, -1.0):
            # The wall z = slope (side x - 1), from the bottom (0, -slope) to the edge (side, 0).
            normal = np.array([-side * slope, 1.0]) / math.hypot(slope, 1.0)
            toward = normal @ step
            if toward < -1e-12:
                distance = normal @ (np.array([0.0, -slope]) - position) / toward
                place = position + distance * step
                if distance > -1e-12 and 0.0 <= side * place[0] <= 1.0:
                    reach.append((distance, place, normal))
        if not reach:
            return hits
        _, position, normal = min(reach, key=lambda each: each[0])
        step = step - 2 * (step @ normal) * normal
        hits += 1


@pytest.mark.parametrize(("angle", "psi"), [(20.0, 0.3), (45.0, 1.2), (60.0, 0.7), (72.0, -0.4), (50.0, 1.4)])
def test_unfolding_counts_the_walls_that_a_ray_meets(angle, psi):
    slope = math.tan(math.radians(angle))
    x = (np.arange(4000) + 0.5) / 2000 - 1
    hits = np.array([followed(slope, psi, place) for place in x])
    for count in range(1, math.ceil(180 / (180 - 2 * angle)) + 1):
        assert unfolded(slope, psi, count) == pytest.approx((hits == count).mean(), abs=2e-3)


def test_the_document_has_every_row(quick):
    rows = quick("numbers of hits")
    text = markdown(rows)
    assert all(row.quantity in text for row in rows)
    assert summary(rows) in text
    with pytest.raises(ValueError, match="'nonsense' is not known: choose from "):
        validate(True, ("nonsense",))
