"""Models by name and settings; what is not said is the specimen's."""

import pytest

from gonio.models import (
    GGX,
    Beckmann,
    CookTorrance,
    Lambert,
    Microfacet,
    PoulinFournier,
    SmithCorrelated,
    VCavity,
    Ward,
)
from gonio.models.parameters import BOUNDS, candidates, value_of, with_values
from gonio.models.specimen import Specimen
from gonio.optics import Conductor, Dielectric, Lambertian, Mirror
from microsurfaces import Cylinders

GOLD = Conductor("Au")
ROUGH = Specimen({"beckmann_alpha": 0.25}, GOLD)


@pytest.mark.parametrize(
    ("text", "model"),
    [
        ("CookTorrance", CookTorrance(m=0.25, material=GOLD)),
        ("cook-torrance", CookTorrance(m=0.25, material=GOLD)),
        ("cook_torrance m=0.3", CookTorrance(m=0.3, material=GOLD)),
        ("cook-torrance m=0.3, k_d=0.25", CookTorrance(m=0.3, material=GOLD, k_d=0.25, k_s=0.75)),
        ("cook-torrance: k_s=1", CookTorrance(m=0.25, material=GOLD)),
        ("cook-torrance m_x=0.1 m_y=0.2 rotation=30", CookTorrance(m_x=0.1, m_y=0.2, material=GOLD, rotation=30.0)),
        (
            "cook-torrance scales=[[0.1, 0.5], [0.4, 0.5]]",
            CookTorrance(scales=((0.1, 0.5), (0.4, 0.5)), material=GOLD),
        ),
        ('cook-torrance normalisation="half"', CookTorrance(m=0.25, material=GOLD, normalisation="half")),
        ("cook-torrance material.kind=Mirror", CookTorrance(m=0.25, material=Mirror())),
        ("cook-torrance material.eta=1.2 material.k=3.0", CookTorrance(m=0.25, material=Conductor(eta=1.2, k=3.0))),
        (
            "microfacet distribution.kind=GGX masking.kind=VCavity",
            Microfacet(distribution=GGX(0.25), masking=VCavity(), material=GOLD),
        ),
        ("ward alpha=0.2", Ward(alpha=0.2)),
        ("lambert reflectance=0.3", Lambert(0.3)),
        ("lambert reflectance=.3", Lambert(0.3)),
        ("lambert reflectance=1", Lambert(1.0)),
        ("poulin-fournier distance=3", PoulinFournier(local=GOLD, distance=3.0)),
    ],
)
def test_a_model_in_words(text, model):
    assert ROUGH.described(text) == model


def test_nested_tables_say_the_same():
    settings = {"distribution": {"alpha": 0.4, "kind": "GGX"}, "material": {"kind": "Dielectric", "eta": 1.5}}
    expected = Microfacet(distribution=GGX(0.4), masking=SmithCorrelated(), material=Dielectric(eta=1.5))
    assert ROUGH.model("Microfacet", settings) == expected


def test_the_recipe_of_the_surface_tells_more():
    brushed = Specimen({"beckmann_alpha": 0.25}, GOLD, Cylinders(distance=1.5, profile="grooves"))
    assert brushed.described("poulin-fournier").distance == 1.5
    assert brushed.described("poulin-fournier floor_height=0.2").floor_height == 0.2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wardd", "no such model; choose from .*; did you mean Ward?"),
        ("ward", "fit it"),
        ("lambert", "use a microfacet model"),
        ("cook-torrance m=-1", "m = -1.0: must be greater than 0"),
        ("cook-torrance mm=1", "mm: CookTorrance has no such parameter"),
        ("cook-torrance m=x", "m = 'x': must be a number"),
        ("cook-torrance m.x=1", "m is a value, not a table"),
        ("cook-torrance material.kind=Gold", "unknown; choose Mirror, Conductor or Dielectric"),
        ("poulin-fournier", "not known to be made of them"),
        ("microfacet masking.kind=Cavity", "unknown; choose"),
    ],
)
def test_what_is_wrong_is_told_in_a_sentence(text, words):
    with pytest.raises(ValueError, match=words) as error:
        ROUGH.described(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["Ward", "AshikhminShirley", "PoulinFournier", "Lambert", "OrenNayar"])
def test_what_the_specimen_does_not_tell_has_a_place_to_start_a_fit(name):
    model = ROUGH.described(name, to_fit=True)
    for parameter, (low, high) in model.free.items():
        assert low < value_of(model, parameter) < high


def test_parameters_by_name():
    model = Microfacet(distribution=Beckmann(0.3), masking=SmithCorrelated(), material=GOLD)
    assert "distribution.alpha" in candidates(model)
    assert all(name.rsplit(".", 1)[-1] in BOUNDS for name in candidates(model))
    assert value_of(model, "distribution.alpha_x") == pytest.approx(0.3)
    assert value_of(model, "material.k") > 1.0
    moved = with_values(
        model, {"distribution.alpha_x": 0.1, "distribution.alpha_y": 0.2, "material.eta": 0.5, "material.k": 2.0}
    )
    assert moved.distribution == Beckmann(alpha_x=0.1, alpha_y=0.2)
    with pytest.raises(ValueError, match="'roughness' is no parameter of Microfacet that can be fitted"):
        value_of(model, "roughness")
    mixed = CookTorrance(m=0.3, material=Mirror(), k_d=0.5, k_s=0.5)
    assert with_values(mixed, {"k_d": 0.8}).k_s == pytest.approx(0.2)
    assert with_values(mixed, {"k_d": 0.9, "k_s": 0.9}).k_d == pytest.approx(0.5)
    assert with_values(Ward(alpha=0.1), {"specular": 0.5}).specular == 0.5
    with pytest.raises(ValueError, match="use a microfacet model"):
        Specimen({}, Mirror()).described("Lambert")
    assert Specimen({}, Lambertian(0.5)).described("lambert") == Lambert(0.5)


# --- An external specimen --------------------------------------------------------------------------------------------

UNKNOWN = Specimen({}, None)


@pytest.mark.parametrize(
    ("text", "model"),
    [
        ("cook-torrance m=0.3 material.name=Au", CookTorrance(m=0.3, material=GOLD)),
        ("cook-torrance m=0.3 material.name=SiO2", CookTorrance(m=0.3, material=Dielectric("SiO2"))),
        ("cook-torrance m=0.3 material.eta=1.5", CookTorrance(m=0.3, material=Dielectric(eta=1.5))),
        ("cook-torrance m=0.3 material.eta=0.2 material.k=3", CookTorrance(m=0.3, material=Conductor(eta=0.2, k=3.0))),
        ("cook-torrance m=0.3 material.kind=Mirror", CookTorrance(m=0.3, material=Mirror())),
        (
            "microfacet distribution.kind=GGX distribution.alpha=0.2 material.name=Au",
            Microfacet(distribution=GGX(0.2), masking=SmithCorrelated(), material=GOLD),
        ),
        ("poulin-fournier local.reflectance=0.5", PoulinFournier(local=Lambertian(0.5))),
        ("lambert reflectance=0.3", Lambert(0.3)),
        ("ward alpha=0.2", Ward(alpha=0.2)),
    ],
)
def test_what_a_file_does_not_tell_can_be_said(text, model):
    assert UNKNOWN.described(text) == model


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "cook-torrance",
            r"tells m and material\.name of the specimen: give them, such as m=0\.12 material\.name=Au\.",
        ),
        ("cook-torrance m=0.3", r"tells material\.name of the specimen: give it, such as material\.name=Au\."),
        ("cook-torrance material.name=Au", "roughness: give m"),
        ("microfacet", r"tells distribution\.alpha and material\.name"),
        ("lambert", r"tells reflectance of the specimen: give it, such as reflectance=0\.25\."),
        ("poulin-fournier distance=3", r"tells local\.name of the specimen"),
        ("ward", "tells alpha, specular and reflectance"),
        ("cook-torrance m=0.3 material.name=Gold", "did you mean 'Au'"),
        ("cook-torrance m=0.3 material=Au", "must be a table whose kind is Mirror, Conductor or Dielectric"),
    ],
)
def test_what_must_be_said_is_asked_for_in_a_sentence(text, words):
    with pytest.raises(ValueError, match=words) as error:
        UNKNOWN.described(text)
    assert "\n" not in str(error.value)


def test_a_fit_needs_the_material_only():
    model = UNKNOWN.described("cook-torrance material.name=Au", to_fit=True)
    assert model.material == GOLD
    assert 0.005 < model.m < 3.0
    with pytest.raises(ValueError, match=r"nothing tells material\.name of the specimen"):
        UNKNOWN.described("cook-torrance", to_fit=True)
    with pytest.raises(ValueError, match="material is missing"):
        Specimen({"beckmann_alpha": 0.25}, Lambertian()).described("cook-torrance m=0.3")


@pytest.mark.parametrize(
    ("short", "long"),
    [
        ("microfacet alpha=0.3 name=Au", "microfacet distribution.alpha=0.3 material.name=Au"),
        (
            "microfacet distribution=GGX alpha=0.3 eta=1.5",
            "microfacet distribution.kind=GGX distribution.alpha=0.3 material.eta=1.5",
        ),
        (
            "poulin-fournier local=Mirror distance=3 floor_height=0",
            "poulin-fournier local.kind=Mirror distance=3 floor_height=0",
        ),
        (
            "smith-multiple-scattering alpha=0.4 name=Au",
            "smith-multiple-scattering distribution.alpha=0.4 material.name=Au",
        ),
    ],
)
def test_parts_need_not_be_named_where_only_one_can_be_meant(short, long):
    nothing = Specimen({}, None)
    assert nothing.described(short) == nothing.described(long)
