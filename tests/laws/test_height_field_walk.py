"""Laws of exactness: every shortcut over a height field is a proof, so that results with and without are the same."""

import math

import height_field_laws as laws
import numpy as np
import pytest
from height_field_laws import INSTRUMENTS, certified
from reliefs import RELIEFS, gaussian, on_facets
from specimens import COARSE_GRID

import microsurfaces as ms
from gonio import optics
from gonio.goniometer import Goniometer
from gonio.transport.accelerator import BLOCK, Accelerator
from gonio.transport.scene import Scene

pytestmark = pytest.mark.slow


@pytest.fixture(params=RELIEFS)
def relief(request):
    return RELIEFS[request.param]()


@pytest.mark.parametrize(("material", "setting"), INSTRUMENTS, ids=lambda x: "" if isinstance(x, dict) else repr(x))
def test_every_shortcut_is_a_proof(relief, material, setting):
    laws.every_shortcut_is_a_proof(relief, material, setting)


def test_no_node_is_lower_than_what_it_stands_for(relief):
    laws.no_node_is_lower_than_what_it_stands_for(relief)


def test_what_is_certain_to_escape_hits_nothing(relief):
    laws.what_is_certain_to_escape_hits_nothing(relief)


def test_first_hits_are_those_of_embree(relief):
    laws.first_hits_are_those_of_embree(relief)


@pytest.mark.parametrize("material", [optics.Mirror(), optics.Lambertian(0.9)], ids=repr)
@pytest.mark.parametrize("name", ["gaussian .5", "between nodes", "33 x 33", "walls", "ramps"])
def test_embree_measures_the_same(name, material):
    laws.embree_measures_the_same(name, material)


@pytest.mark.parametrize("phi_i", [0.0, 37.0, 211.0])
@pytest.mark.parametrize("phi_step", [0.5, 1.0, 7.2, 90.0, 180.0])
@pytest.mark.parametrize("theta_step", [0.5, 1.0, 5.0])
def test_directions_are_put_into_the_bins_that_their_angles_lie_in(theta_step, phi_step, phi_i):
    laws.directions_are_put_into_the_bins_that_their_angles_lie_in(theta_step, phi_step, phi_i)


def test_guesses_are_worth_what_the_proofs_say(relief):
    """The share of the blocks that see the source."""
    accelerator, rng = Accelerator.of(relief), np.random.default_rng(2)
    rows, columns = (index.ravel() << BLOCK for index in np.indices(accelerator.horizon_code.shape[:2]))
    for dx, dy, dz in rng.normal(size=(30, 3)) * [1, 1, 2]:
        certain, _ = certified(accelerator, columns, rows, np.full(rows.size, dx), np.full(rows.size, dy), dz)
        assert accelerator.certainty(dx, dy, dz) == pytest.approx(np.mean(certain & (dz > 0)))


def test_vertical_light_meets_a_needle_from_which_nothing_is_certain():
    """Steeper than any code can say."""
    heights = np.zeros((512, 512))
    heights[100, 200] = 1.0
    scene = Scene(ms.HeightField(heights, (1.0, 1.0)), optics.Mirror())
    assert scene.geometry.traced.horizon_code.max() == 255
    goniometer = Goniometer(theta_i=(0,), paths=50_000, wavelengths=(550,), detector=COARSE_GRID)
    assert goniometer.measure(scene).albedo()["albedo"].item() == 1.0


def test_proofs_are_not_idle():
    """Of light that is reflected diffusely, and of first hits at 45 degrees, most needs no search."""
    rng = np.random.default_rng(3)
    for alpha, share in ((0.1, 0.9), (0.3, 0.7), (0.5, 0.5)):
        relief = gaussian(alpha)
        accelerator = Accelerator.of(relief)
        i, j, *_ = on_facets(relief.heights, 20_000, rng)
        phi, sin2 = rng.uniform(0, 2 * math.pi, i.size), rng.uniform(0, 1, i.size)
        dx, dy = (np.sqrt(sin2) * f(phi) / step for f, step in zip((np.cos, np.sin), relief.spacing, strict=True))
        certain, _ = certified(accelerator, i, j, dx, dy, np.sqrt(1 - sin2))
        assert certain.mean() > share
