"""Models of every kind: the laws of models are tested on all of them."""

from gonio.models import (
    GGX,
    AshikhminShirley,
    Beckmann,
    CookTorrance,
    Lambert,
    Microfacet,
    Mixture,
    OrenNayar,
    PoulinFournier,
    SmithCorrelated,
    SmithSeparable,
    VCavity,
    Ward,
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
    OrenNayar(0.0, 1.0),
    OrenNayar(30.0, 0.95),
    OrenNayar(50.0, 1.0, form="single"),
    OrenNayar(40.0, 1.0, form="qualitative"),
    Ward(alpha=0.1, specular=1.0),
    Ward(alpha=1.0, specular=0.6, reflectance=0.4),
    Ward(alpha_x=0.05, alpha_y=0.4, rotation=25.0, specular=0.7, reflectance=0.3),
    AshikhminShirley(n=0.0, specular=1.0),
    AshikhminShirley(n=1.0, specular=0.04, reflectance=1.0),
    AshikhminShirley(n=300.0, specular=0.3, reflectance=1.0),
    AshikhminShirley(n_u=10.0, n_v=1000.0, rotation=-15.0, specular=0.9, reflectance=0.5),
    PoulinFournier(local=CookTorrance(m=0.2, material=Mirror()), profile="grooves", groups=((0.4, 0.0), (0.6, 70.0))),
]
"""None of them creates energy; all of them are reciprocal functions."""
