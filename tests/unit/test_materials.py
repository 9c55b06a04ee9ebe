"""Materials: what they accept, and that they come back from what they are written as."""

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from specimens import SPECULAR

from gonio import optics
from gonio.optics import (
    Conductor,
    Dielectric,
    Lambertian,
    Material,
)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Conductor("gold"), "did you mean 'Au'"),
        (lambda: Conductor("aluminum"), "did you mean 'Al'"),
        (lambda: Conductor("unobtainium"), "choose one of Ag, Al, Au, Cr, Cu, Fe, Ni, Ti, W"),
        (lambda: Conductor("SiO2"), "give it as a Dielectric"),
        (lambda: Dielectric("Au"), "give it as a Conductor"),
        (lambda: Dielectric("BK7"), "did you mean 'N-BK7'"),
        (lambda: Conductor(), "either a name, such as 'Au', or both eta and k"),
        (lambda: Conductor(eta=1.0), "either a name"),
        (lambda: Conductor("Au", eta=1.0, k=1.0), "either a name"),
        (lambda: Conductor(eta=0.0, k=1.0), "greater than 0"),
        (lambda: Conductor(eta=1.0, k=-1.0), "greater than or equal to 0"),
        (lambda: Dielectric(), "either a name, such as 'N-BK7', or eta"),
        (lambda: Dielectric("SiO2", eta=1.5), "either a name"),
        (lambda: Dielectric(eta=float("inf")), "finite"),
        (lambda: Lambertian(1.1), "less than or equal to 1"),
    ],
)
def test_wrong_materials_are_told_in_words(make, words):
    with pytest.raises(ValidationError, match=words):
        make()


@pytest.mark.parametrize(
    "material", [*SPECULAR, Conductor(eta=0.2, k=3.9), Dielectric(eta=1.5), Lambertian(0.5)], ids=repr
)
def test_materials_round_trip_by_kind(material):
    adapter = TypeAdapter(Material)
    assert adapter.validate_json(adapter.dump_json(material, exclude_none=True)) == material
    assert eval(repr(material), vars(optics)) == material


def test_one_index_for_all_wavelengths():
    assert np.array_equal(Conductor(eta=0.2, k=3.9).refractive_index((400.0, 10_000.0)), [0.2 + 3.9j] * 2)
    assert np.array_equal(Dielectric(eta=1.5).refractive_index((400.0, 10_000.0)), [1.5 + 0j] * 2)
    assert Dielectric("TiO2").refractive_index((380.0, 550.0)).imag.max() == 0.0
