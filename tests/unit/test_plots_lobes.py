"""Lobes in space: their shape, their colours, what stands beside them, and the files that hold them."""

import json
import subprocess
import sys
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
import pyvista
import trimesh
from matplotlib.colors import to_rgb
from pictures import BY_VTK_AND_BY_MATPLOTLIB, GL, GRID, from_function, measured, pixels, where
from PIL import Image
from synthetic import external

import gonio
import microsurfaces as ms
from gonio import plots
from gonio.detectors import HemisphereGrid, Klems
from gonio.models import CookTorrance, Lambert
from gonio.plots import LobeStyle, lobe_files, lobe_scene, patches, style
from gonio.plots.lobe_scene import Ground, Scale, Shell, solid_angle, surface
from gonio.sphere import direction


def lobe_of(data):
    return patches.scattered(data, data["brdf"].sel(order="all").values)[..., 0]


@BY_VTK_AND_BY_MATPLOTLIB
def test_lobes_have_the_incident_direction_left_and_the_specular_right(rendered, monkeypatch):
    """A lobe turned to dphi = 150 is bright right of the middle, by VTK as by matplotlib."""
    monkeypatch.setattr(style, "can_render", lambda: rendered)
    lobe = from_function(lambda t, p: np.exp(-(((t - 40) / 15) ** 2) - ((p - 150) / 20) ** 2))
    picture = pixels(plots.lobes(lobe))
    picture[:, int(0.8 * picture.shape[1]) :] = 255.0
    incident, specular = (where(picture, colour)[0] for colour in (style.SOURCE, style.SPECULAR))
    assert min(len(incident), len(specular)) > 100
    assert np.median(incident) < 0.4 * picture.shape[1] < np.median(specular)
    red, green, blue = np.moveaxis(picture, -1, 0)
    bright = np.nonzero((green > 150) & (green > 1.5 * blue) & (green > 0.9 * red))[1]
    assert len(bright) > 100
    assert np.median(bright) > 0.4 * picture.shape[1]


@pytest.mark.parametrize(
    "grid",
    [
        HemisphereGrid(),
        HemisphereGrid(theta_step=2.0, phi_step=3.0),
        GRID,
        HemisphereGrid(theta_step=15.0, phi_step=30.0),
        HemisphereGrid(theta_step=3.0, phi_step=5.0, spacing="projected_area"),
    ],
)
def test_a_lambertian_lobe_is_a_sphere(grid):
    """f cos, but where the horizon cuts the patch, and as round as the patch that it is averaged over lets it be."""
    data = from_function(lambda t, p: 0.5 / np.pi, grid).dataset.isel(theta_i=0, phi_i=0)
    light = lobe_of(data)
    patch = patches.width(data)
    expected = 0.5 / np.pi * np.cos(np.radians(patches.THETA))
    inside = 90 - patch > patches.THETA
    # cos averaged over a patch of radius r differs by cos r²/4 at most, on pieces that are half a patch wide.
    tolerance = 0.5 / np.pi * (np.radians(patch) ** 2 / 4 + 0.01)
    np.testing.assert_allclose(light[inside], np.broadcast_to(expected[:, None], light.shape)[inside], atol=tolerance)
    assert patches.THETA[0] == 0
    assert patches.THETA[-1] == 90
    assert not light[-1].any()
    assert solid_angle(light) == pytest.approx(np.pi, rel=0.01)
    # The BRDF itself is constant, whatever the patches.
    brdf = patches.averaged(data, data["brdf"].sel(order="all").values)
    np.testing.assert_allclose(brdf, 0.5 / np.pi, rtol=1e-12)


def test_patches_average_with_the_solid_angle():
    """One bin of light near the pole keeps its energy and makes no spike: a patch of it at most, (1 - (d/r)²)² wide."""
    grid = HemisphereGrid()
    light = lobe_of(from_function(lambda t, p: ((t == 2) & (p == 90)) * 1.0, grid).dataset.isel(theta_i=0, phi_i=0))
    energy = grid.projected_solid_angles().reshape(grid.shape)[2, 90]
    patch = np.pi * np.radians(patches.PATCH) ** 2 / 3
    assert light.max() == pytest.approx(energy / patch, rel=0.1)
    assert patches.DPHI[np.unravel_index(light.argmax(), light.shape)[1]] == 90


def test_the_radius_is_logarithmic_for_needles_and_unequal_lobes_or_as_told():
    def shape(width, height=1.0):
        return np.repeat((height * np.exp(-((patches.THETA / width) ** 2)))[:, None], 72, axis=1)

    assert not Scale.of([shape(30), shape(30, 0.5)]).logarithmic
    assert Scale.of([shape(3)]).logarithmic
    assert not Scale.of([shape(3)], "linear").logarithmic
    assert Scale.of([shape(30)], "log").logarithmic
    scale = Scale.of([shape(30), shape(30, 0.01)])
    assert scale.logarithmic
    # Three decades from the centre to the arc.
    np.testing.assert_allclose(
        scale.radius(np.array([0.0, 1e-3, 1e-2, 1e-1, 1.0])), [0, 0, 1 / 3, 2 / 3, 1], atol=1e-12
    )
    assert "logarithmic" in scale.words
    np.testing.assert_allclose(Scale.of([shape(30, 2.0)]).radius(np.array([0.0, 0.5, 2.0])), [0, 0.25, 1])


@pytest.mark.parametrize(
    ("outcome", "works"),
    [
        (SimpleNamespace(returncode=0), True),
        (SimpleNamespace(returncode=-11), False),
        (subprocess.TimeoutExpired("python", 120), False),
        (OSError("no processes left"), False),
    ],
)
def test_the_probe_survives_a_segmentation_fault(outcome, works, monkeypatch):
    def run(*_, **__):
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    monkeypatch.setattr(style.subprocess, "run", run)
    assert style.can_render.__wrapped__() is works


@BY_VTK_AND_BY_MATPLOTLIB
def test_a_lobe_has_a_hole_where_nothing_is_known(rendered, monkeypatch):
    """Only the plane of incidence is known: of the lobe a ribbon is left."""
    monkeypatch.setattr(style, "can_render", lambda: rendered)
    counts = []
    for unknown in (False, GRID.dphi % 180 > 0):
        made = external(Lambert(0.5), detector=GRID, unknown=np.reshape(unknown, (-1, 1)))
        picture = pixels(plots.lobes(made))[:, :700]
        red, green, blue = np.moveaxis(picture, -1, 0)
        counts.append(((green > red + 40) & (green > 0.8 * blue)).sum())
    assert 100 < counts[1] < 0.3 * counts[0]


# --- Beside and within one another -----------------------------------------------------------------------------------


@pytest.fixture
def seen(monkeypatch):
    """What is drawn of panels, which are left empty."""
    views = []
    monkeypatch.setattr(sys.modules["gonio.plots.lobes"], "draw", lambda panel, view, *_, **__: views.append(view))
    return views


@pytest.fixture(scope="module")
def orders():
    return measured(theta_i=(0.0, 40.0), phi_i=(0.0,), wavelengths=(450.0, 550.0, 650.0))


def test_orders_are_nested_and_sum_to_the_whole(orders, seen):
    plots.lobes(orders, style=LobeStyle(orders=True))
    assert len(seen) == 2
    for view in seen:
        whole, *parts = view.shells
        np.testing.assert_allclose(sum(part.value for part in parts), whole.value, rtol=1e-9, atol=1e-12)
        assert [shell.paint for shell in view.shells] == list(view.legend.values())
        assert list(view.legend) == ["all orders", "1 hit", "2 hits", "3 and more hits"]
        assert max(shell.opacity for shell in view.shells) < 1


def test_overlaid_lobes_share_a_panel(orders, seen):
    plots.lobes(orders, style=LobeStyle(overlaid=True))
    (view,) = seen
    assert [incidence.theta for incidence in view.incidences] == [0, 40]
    assert len(view.shells) == 2
    assert "0°, 40°" in view.title


def test_a_model_stands_beside_what_it_describes(orders, seen):
    """Half of what was measured: everywhere -50 %, the darkest blue; the radius is that of the measured lobe."""
    albedo = 0.6
    made = external(Lambert(albedo), detector=GRID, theta_i=(30.0,))
    plots.lobes(made, models=[Lambert(albedo / 2)])
    ours, theirs, difference = seen
    np.testing.assert_allclose(theirs.shells[0].value, ours.shells[0].value / 2, rtol=1e-9)
    np.testing.assert_array_equal(difference.shells[0].value, ours.shells[0].value)
    np.testing.assert_allclose(
        difference.shells[0].paint[:-1], np.broadcast_to(to_rgb("#053061"), (60, 240, 3)), atol=2e-3
    )
    seen.clear()
    plots.lobes(orders, models=[CookTorrance(m=0.3, material=gonio.Conductor("Au"))] * 2)
    assert len(seen) == 6
    assert seen[0].title.startswith("measured, 1 hit")
    first = orders.dataset["brdf"].sel(order="1", wavelength=[550.0]).isel(theta_i=0, phi_i=0)
    np.testing.assert_array_equal(
        seen[0].shells[0].value, patches.scattered(orders.dataset.isel(theta_i=0, phi_i=0), first.values)[..., 0]
    )


def test_true_colours_are_those_of_the_albedo(seen):
    """A grey that reflects a half is grey, 188 of 255 on a screen, in every direction; its luminance is the radius."""
    made = external(Lambert(0.5), detector=GRID, wavelengths=(450.0, 550.0, 650.0))
    plots.lobes(made, style=LobeStyle(true_colour=True))
    (shell,) = seen[0].shells
    np.testing.assert_allclose(255 * shell.paint[:-1], 188, atol=0.6)
    np.testing.assert_allclose(shell.value[0], 0.5 / np.pi, rtol=0.01)
    seen.clear()
    red = external(Lambert(0.5), detector=GRID, wavelengths=(611.4, 549.1, 464.2), attributes={"basis": "RGB"})
    red.external["brdf"][..., 1:] = 0.0
    plots.lobes(red, style=LobeStyle(true_colour=True))
    paint = seen[0].shells[0].paint[:-1]
    assert paint[..., 0].min() > 0.5
    assert paint[..., 1:].max() == 0.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"orders": True, "overlaid": True}, "one at a time"),
        ({"orders": True, "models": [Lambert(0.5)]}, "one at a time"),
        ({"orders": True, "true_colour": True}, "not the true ones"),
        ({"models": [Lambert(0.5)] * 4}, "4 models are too many"),
    ],
)
def test_what_cannot_go_together_is_told(orders, options, words):
    models = options.pop("models", ())
    with pytest.raises(ValueError, match=words):
        plots.lobes(orders, models=models, style=LobeStyle(**options))


def test_what_is_not_known_is_told():
    made = external(detector=GRID)
    with pytest.raises(ValueError, match="does not tell the orders"):
        plots.lobes(made, style=LobeStyle(orders=True))
    with pytest.raises(ValueError, match="three wavelengths or more, and this measurement has 1"):
        plots.lobes(made, style=LobeStyle(true_colour=True))
    with pytest.raises(ValueError, match=r"two measured theta_i at least.*draw a picture"):
        plots.lobe_film(made, "x.gif")


def test_lobes_of_klems_patches_are_steps(seen):
    made = measured(Klems(basis="quarter"), wavelengths=(550.0,))
    plots.lobes(made)
    (incidence,) = seen[0].incidences[:1]
    brdf = incidence.data["brdf"].sel(order="all").values[..., 0]
    known = np.unique(made.dataset["brdf"].sel(order="all", theta_i=incidence.theta, phi_i=0.0).values)
    assert set(np.unique(brdf)) <= set(known)


# --- The ground ------------------------------------------------------------------------------------------------------


def test_the_ground_is_true_to_scale_below_the_plane_and_turned_with_the_specimen():
    x = 2.0 * np.arange(200)
    relief = ms.HeightField(np.broadcast_to(3 * np.sin(2 * np.pi * x / 80), (200, 200)), (2.0, 2.0))
    ground = Ground.of(relief)
    scale = Ground.SIDE / (96 * 2.0)
    z = ground.points[..., 2]
    assert z.shape == (97, 97)
    assert z.max() < 0
    assert z.max() - z.min() == pytest.approx(6 * scale, rel=0.01)
    assert np.hypot(*np.moveaxis(ground.points[..., :2], -1, 0)).max() <= 1
    assert "192 µm" in ground.words
    # Light from +x comes from azimuth 0; light from +y sees x on its right.
    np.testing.assert_allclose(ground.turned(0.0), ground.points)
    np.testing.assert_allclose(ground.turned(90.0)[..., 1], -ground.points[..., 0], atol=1e-12)


@BY_VTK_AND_BY_MATPLOTLIB
def test_the_ground_is_drawn_under_the_lobe(rendered, monkeypatch):
    monkeypatch.setattr(style, "can_render", lambda: rendered)
    made = external(Lambert(0.5), detector=GRID)
    flat = ms.HeightField(np.zeros((64, 64)), (1.0, 1.0))
    bare, laid = (pixels(plots.lobes(made, style=LobeStyle(ground=ground))) for ground in (None, flat))
    assert bare.shape == laid.shape
    changed = (np.abs(bare - laid).max(axis=-1) > 20)[200:]
    grey = np.ptp(laid[200:], axis=-1) < 25
    assert (changed & grey).sum() > 10_000


# --- Files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".vtp", ".glb", ".gltf"])
def test_lobes_for_other_programs_have_their_size_and_colours(suffix, tmp_path):
    """Two Lambertian lobes, spheres of diameter 1, stand side by side; those at 1/sr's peak are yellow."""
    made = external(Lambert(0.5), detector=HemisphereGrid(theta_step=2.0, phi_step=3.0), theta_i=(0.0, 60.0))
    path = plots.lobe_meshes(made, tmp_path / f"lobes{suffix}")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    if suffix == ".vtp":
        mesh = pyvista.read(path)
        points, colours = np.asarray(mesh.points), np.asarray(mesh["colour"])
        assert float(np.nanmax(mesh["brdf_cos"])) == pytest.approx(0.5 / np.pi, rel=0.01)
    else:
        loaded = trimesh.load_scene(path)
        assert len(loaded.geometry) == 2 + 4
        nodes = [loaded.graph[node] for node in sorted(loaded.graph.nodes_geometry)]
        lobes = [(loaded.geometry[name], place) for place, name in nodes if name.startswith("lobe")]
        points = np.concatenate([g.copy().apply_transform(place).vertices for g, place in lobes])
        colours = np.concatenate([g.visual.vertex_colors[:, :3] for g, _ in lobes])
        if suffix == ".gltf":
            assert json.loads(path.read_text())["asset"]["version"] == "2.0"
    first = points[points[:, 0] < 1.3]
    np.testing.assert_allclose(first.max(axis=0), [0.5, 0.5, 1.0], atol=0.02)
    np.testing.assert_allclose(
        points[points[:, 0] > 1.3].mean(axis=0), np.add(first.mean(axis=0), (2.6, 0, 0)), atol=1e-3
    )
    top = colours[points[:, 2] > 0.995]
    np.testing.assert_allclose(top, np.broadcast_to(255 * np.array(to_rgb("#fde725")), top.shape), atol=6)


def test_a_film_goes_forth_and_back_and_says_that_it_is_interpolated(tmp_path, monkeypatch):
    lobes = sys.modules["gonio.plots.lobes"]
    monkeypatch.setattr(lobe_files, "FRAMES", 3)
    monkeypatch.setattr(style, "can_render", lambda: False)
    made = external(Lambert(0.5), detector=GRID, theta_i=(10.0, 60.0)).as_isotropic()
    texts = []
    head = lobes.headline
    monkeypatch.setattr(lobes, "headline", lambda *words: (texts.append(words), head(*words)))
    path = plots.lobe_film(made, tmp_path / "lobes.gif")
    with Image.open(path) as film:
        assert film.n_frames == 4
        tips = []
        for k in range(4):
            film.seek(k)
            tips.append(np.median(where(np.asarray(film.convert("RGB")).astype(float), style.SOURCE)[1]))
    # The incident direction sinks, and rises again.
    assert tips[0] < tips[1] < tips[2]
    assert tips[1] == pytest.approx(tips[3], abs=3)
    assert all("interpolated between measured incidences" in words for words in texts)


def test_a_film_for_slides_is_an_mp4_of_even_size(tmp_path, monkeypatch):
    monkeypatch.setattr(lobe_files, "FRAMES", 2)
    monkeypatch.setattr(style, "can_render", lambda: False)
    made = external(Lambert(0.5), detector=GRID, theta_i=(10.0, 60.0)).as_isotropic()
    path = plots.lobe_film(made, tmp_path / "lobes.mp4")
    assert path.read_bytes()[4:8] == b"ftyp"
    words = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path), str(tmp_path / "%d.png")]
    subprocess.run(words, check=True, timeout=60)
    assert sorted(p.name for p in tmp_path.glob("*.png")) == ["1.png", "2.png"]
    first = pixels(tmp_path / "1.png")
    assert first.shape[0] % 2 == first.shape[1] % 2 == 0
    assert len(where(first, style.SOURCE)[0]) > 30


def test_without_the_library_a_film_says_what_to_install(monkeypatch):
    def missing(name):
        raise ImportError(name=name)

    monkeypatch.setattr("gonio.plots.lobe_files.import_module", missing)
    with pytest.raises(ValueError, match=r"without imageio.*gonio\[report\]"):
        plots.lobe_film(external(detector=GRID, theta_i=(0.0, 30.0)), "x.mp4")


def test_vectors_are_vectors(tmp_path):
    """No picture within, and as many filled facets as the lobe has."""
    made = external(Lambert(0.5), detector=GRID)
    plots.lobes(made, tmp_path / "lobes.svg")
    text = (tmp_path / "lobes.svg").read_text()
    assert text.count("<image") <= 1  # the colour bar
    assert text.count("<path") > 5000


def test_a_window_needs_a_screen(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match="no screen"):
        plots.show_lobes(external(detector=GRID))


def test_surfaces_have_one_pole_and_no_facet_in_a_hole():
    value = np.ones((len(patches.THETA), len(patches.DPHI)))
    value[10] = np.nan
    points, corners, _ = surface(Shell(value), Scale(0.0, 1.0, False))
    assert len(corners) == (60 - 2) * 240
    assert set(corners[:240, 0]) == {0}
    np.testing.assert_allclose(points[0], direction(0.0), atol=1e-12)


@GL
def test_a_window_shows_all_of_every_lobe(monkeypatch):
    """The view is level with its panel's height: it must be wide enough for the plane and both arrows."""
    shown = []
    monkeypatch.setattr("gonio.plots.lobe_scene.require_screen", lambda: None)
    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    monkeypatch.setattr(pyvista.Plotter, "show", lambda self: shown.append(self))
    monkeypatch.setattr(style, "can_render", lambda: False)
    made = external(Lambert(0.5), detector=GRID, theta_i=(0.0, 30.0, 60.0))
    plots.show_lobes(made)
    (window,) = shown
    width, height = window.window_size
    assert len(window.renderers) == 3
    left, right, bottom, top = lobe_scene.WINDOW
    for panel in window.renderers:
        reach = panel.camera.parallel_scale * (width / 3) / height
        assert 2 * panel.camera.parallel_scale == pytest.approx(top - bottom)
        assert 2 * reach == pytest.approx(right - left, rel=0.01)
    window.close()
