"""Models of every kind: the laws of models are tested on all of them."""

from gonio.models import (
    GGX,
    Beckmann,
    CookTorrance,
    Lambert,
    Microfacet,
    Mixture,
    PoulinFournier,
    SmithCorrelated,
    SmithSeparable,
    VCavity,
)
from gonio.optics import Conductor, Dielectric, Lambertian, Mirror


def smith(alpha, material=Mirror()):  # noqa: B008 - a frozen recipe
    return Microfacet(distribution=Beckmann(alpha), masking=SmithCorrelated(), material=material)


ROUGHNESSES = (0.05, 0.3, 0.6, 1.0)

MODELS = [
    Lambert(0.5),
    *(CookTorrance(m=m, material=Mirror()) for m in ROUGHNESSES),
    *(smith(alpha) for alpha in ROUGHNESSES),
    CookTorrance(m=0.3, material=Conductor("Au"), k_d=0.2, k_s=0.8, reflectance=0.5),
    CookTorrance(m_x=0.2, m_y=0.5, rotation=30.0, material=Mirror(), normalisation="textbook"),
    CookTorrance(scales=((0.15, 0.4), (0.5, 0.6)), material=Dielectric("N-BK7"), normalisation="half"),
    smith(0.3, Dielectric("N-BK7")),
    Microfacet(distribution=GGX(0.3), masking=SmithCorrelated(), material=Mirror()),
    Microfacet(distribution=GGX(alpha_x=0.1, alpha_y=0.4, rotation=20.0), masking=VCavity(), material=Conductor("Cu")),
    Microfacet(distribution=Beckmann(alpha_x=0.15, alpha_y=0.45), masking=SmithSeparable(), material=Mirror()),
    Microfacet(
        distribution=Mixture(components=((0.4, Beckmann(0.15)), (0.6, GGX(0.5)))),
        masking=SmithCorrelated(),
        material=Mirror(),
    ),
    PoulinFournier(local=Lambertian(0.9), distance=2.5, floor_height=0.2),
    PoulinFournier(local=CookTorrance(m=0.2, material=Mirror()), profile="grooves", groups=((0.4, 0.0), (0.6, 70.0))),
]
"""None of them creates energy; all of them are reciprocal functions."""
