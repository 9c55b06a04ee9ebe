"""Masking and shadowing: the share of the facets of one normal that both the lamp and the detector see.

A masking is asked for `g2(distribution, wi, wo, wh)`: shapes (..., 3), all unit vectors, `wi` and `wo` above the
horizon.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.models.distributions import Distribution
from gonio.sphere import Vectors
from microsurfaces.recipe import recipe

Array = NDArray[np.float64]


@recipe
class SmithCorrelated:
    """Smith's masking with heights in common: a facet that the lamp sees is high, and so the detector sees it sooner.

    G2 = 1 / (1 + Lambda(wi) + Lambda(wo)). It treats the heights and slopes of neighbouring facets as independent,
    which makes each of the two factors exact on average over the normals and G2 good to a few per cent on Gaussian
    surfaces, except where `wo` comes within some degrees of `wi`: there the two visibilities are one event, and G2 is
    too small.

    Source: E. Heitz, Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs, Journal of Computer
    Graphics Techniques 3(2), 2014, eq. 99, http://jcgt.org/published/0003/02/03/.
    """

    def g2(self, distribution: Distribution, wi: Vectors, wo: Vectors, wh: Vectors) -> Array:
        """Visible and lit share (...) of the facets whose normal is `wh`: here the same for every normal."""
        share: Array = 1.0 / (1.0 + distribution.smith_lambda(wi) + distribution.smith_lambda(wo))
        return np.broadcast_to(share, np.broadcast_shapes(share.shape, wh.shape[:-1]))


Masking = SmithCorrelated
"""What may hide facets from one another."""


def v_cavity(wi: Vectors, wo: Vectors, wh: Vectors) -> Array:
    """Lit and visible share (...) of a symmetric V-groove's facet: min(1, 2 NH NV / VH, 2 NH NL / VH).

    Exact for infinitely long grooves with coplanar upper edges, at any azimuth. Source: K. E. Torrance, E. M. Sparrow,
    Theory for Off-Specular Reflection From Roughened Surfaces, JOSA 57, 1967, doi:10.1364/JOSA.57.001105; in this form
    Cook and Torrance 1982.
    """
    lower = np.minimum(wi[..., 2], wo[..., 2])
    # VH = LH, and the mean of both has no cancellation at grazing.
    share: Array = np.minimum(1.0, 4.0 * wh[..., 2] * lower / ((wi + wo) * wh).sum(axis=-1))
    return share
