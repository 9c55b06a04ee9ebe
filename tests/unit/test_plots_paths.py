"""Light on a section: what the picture shows and tells."""

import numpy as np
import pictures
import pytest
from matplotlib import colors as colours
from pictures import pixels

import microsurfaces as ms
from gonio.plots.paths import HITS, MASKED, SHADOWED, paths
from gonio.plots.section import round_length
from gonio.transport.profile import Profile, shares, trace

GAUSSIAN = ms.Gaussian(alpha=0.6, correlation_length=10.0, side=120.0, samples=128)
SURFACES = [
    ms.Flat(),
    GAUSSIAN,
    ms.Cylinders(),
    ms.Cylinders(profile="grooves", distance=2.5),
    ms.Cylinders(distance=3.0, floor_height=0.4),
    ms.VGrooves(angle=60.0),
    ms.VGrooves(m=0.4, grooves=16),
]


def where(picture, colour):
    """Columns and rows of the pixels near a colour, of the picture itself and not of what is told beside it."""
    return pictures.where(picture[:, : int(0.75 * picture.shape[1])], colours.to_hex(colour), 12)


def words_of(figure):
    return "\n".join(pictures.words_of(figure))


@pytest.mark.parametrize("surface", SURFACES, ids=str)
def test_every_surface_is_drawn(surface, tmp_path):
    paths(surface, tmp_path / "paths.png", theta_i=60.0, count=9)
    picture = pixels(tmp_path / "paths.png")
    assert [p.name for p in tmp_path.iterdir()] == ["paths.png"]
    assert picture.shape[:2] == (1080, 1920)
    assert min(len(where(picture, colour)[0]) for colour in HITS[:2]) > 500


def test_the_colours_are_the_orders_and_the_bands_lie_where_there_is_no_light():
    """60° grooves at 45°: light comes from the left, so facets toward the right are black, and no ray hits thrice."""
    picture = pixels(paths(ms.VGrooves(angle=60.0)))
    incident, once, twice, thrice, black, yellow = (where(picture, c) for c in (*HITS, SHADOWED, MASKED))
    assert min(len(part[0]) for part in (incident, once, twice, black, yellow)) > 1000
    assert len(thrice[0]) == 0
    # The incident rays come down to the right: none of them in the upper right corner, the reflected ones go up there.
    upper = incident[1] < 0.25 * picture.shape[0]
    assert incident[0][upper].max() < 0.6 * picture.shape[1]
    assert twice[1].min() < 0.2 * picture.shape[0]
    # Each groove spans a third of the picture; what is lit and masked is on its right wall, above what is in shadow.
    inside = (yellow[0] > 0.34 * 0.75 * 1920) & (yellow[0] < 0.65 * 0.75 * 1920)
    assert yellow[1][inside].mean() < black[1].max() - 100


def test_steep_grooves_have_third_hits():
    picture = pixels(paths(ms.VGrooves(angle=75.0), theta_i=10.0))
    assert len(where(picture, HITS[3])[0]) > 1000


def test_it_tells_angle_lengths_and_shares():
    words = words_of(paths(ms.VGrooves(angle=60.0), theta_i=45.0))
    profile = Profile.of(ms.VGrooves(angle=60.0).build(0))
    once = shares(trace(profile, profile.left + profile.period * np.linspace(0.0, 1.0, 4001)[1:-1], 45.0))[0]
    for part in ("angle = 60°", "= 45°", "1 µm", f"{100 * once:.0f} % of the light", "to scale", "shadowed", "masked"):
        assert part in words
    told = words_of(paths(GAUSSIAN))
    for part in ("alpha = 0.6", "correlation_length", "side = 120 µm", "of 120 µm"):
        assert (part in told) == (part != "correlation_length")
    assert "height field" in words_of(paths(GAUSSIAN.build(1)))


def test_the_stretch_that_is_shown_has_multiple_reflection():
    """One steep groove in a plain: that is what is drawn."""
    heights = np.zeros(400)
    heights[300:311] = -4.0 * (1 - np.abs(np.arange(11) - 5) / 5)
    picture = pixels(paths(ms.HeightField(np.tile(heights, (4, 1)), (1.0, 1.0)), theta_i=30.0))
    assert len(where(picture, HITS[2])[0]) > 300


@pytest.mark.parametrize(("length", "width"), [(1, 5), (1, 9.9), (2, 10), (5, 49), (10, 50), (0.2, 1)])
def test_scale_bars_are_round(length, width):
    assert round_length(width) == pytest.approx(length)


@pytest.mark.parametrize("theta_i", [-1.0, 90.0, float("nan")])
def test_angles_outside_the_hemisphere_are_refused(theta_i):
    with pytest.raises(ValueError, match=r"theta_i is .*: expected an angle .* from 0 to below 90"):
        paths(ms.Flat(), theta_i=theta_i)


def test_no_rays_and_unknown_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match="count is 0: expected at least one ray"):
        paths(ms.Flat(), count=0)
    with pytest.raises(ValueError, match="the suffixes are"):
        paths(ms.Flat(), tmp_path / "x.bmp2")
    assert not list(tmp_path.iterdir())
