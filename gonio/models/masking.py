"""Masking and shadowing: the share of the facets of one normal that both the source and the detector see.

A masking is asked for `g2(distribution, wi, wo, wh)`: shapes (..., 3), all unit vectors, `wi` and `wo` above the
horizon.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from gonio.models.distributions import Distribution
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.recipe import recipe


@recipe
class SmithCorrelated:
    """Smith's masking with heights in common: a facet that the source sees is high, and so the detector sees it sooner.

    G2 = 1 / (1 + Lambda(wi) + Lambda(wo)). It treats the heights and slopes of neighbouring facets as independent,
    which makes each of the two factors exact on average over the normals and G2 good to a few per cent on Gaussian
    surfaces, except where `wo` comes within some degrees of `wi`: there the two visibilities are one event, and G2 is
    too small.

    Source: E. Heitz, Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs, Journal of Computer
    Graphics Techniques 3(2), 2014, eq. 99, http://jcgt.org/published/0003/02/03/.
    """

    def g2(self, distribution: Distribution, wi: Vectors, wo: Vectors, wh: Vectors) -> Floats:
        """Visible and lit share (...) of the facets whose normal is `wh`: here the same for every normal."""
        share = 1.0 / (1.0 + distribution.smith_lambda(wi) + distribution.smith_lambda(wo))
        return np.broadcast_to(share, np.broadcast_shapes(share.shape, wh.shape[:-1]))


@recipe
class SmithSeparable:
    """Smith's masking with source and detector taken as independent: G2 = G1(wi) G1(wo), G1 = 1 / (1 + Lambda).

    The form of most renderers. Always below the height-correlated one, by up to a quarter where both directions graze.

    Source: B. G. Smith, Geometrical Shadowing of a Random Rough Surface, IEEE Transactions on Antennas and Propagation
    15(5), 1967, doi:10.1109/TAP.1967.1138991; B. Walter et al., EGSR 2007, doi:10.2312/EGWR/EGSR07/195-206, eq. 23.
    """

    def g2(self, distribution: Distribution, wi: Vectors, wo: Vectors, wh: Vectors) -> Floats:
        """Visible and lit share (...) of the facets whose normal is `wh`: here the same for every normal."""
        share = 1.0 / ((1.0 + distribution.smith_lambda(wi)) * (1.0 + distribution.smith_lambda(wo)))
        return np.broadcast_to(share, np.broadcast_shapes(share.shape, wh.shape[:-1]))


@recipe
class VCavity:
    """The masking of symmetric V-grooves: min(1, 2 NH NV / VH, 2 NH NL / VH).

    Exact for infinitely long grooves with coplanar upper edges, at any azimuth; whatever the distribution of their
    slopes. Real surfaces are no such grooves: on a Gaussian height field it is 6 to 8 % too low near normal incidence.

    Source: K. E. Torrance, E. M. Sparrow, Theory for Off-Specular Reflection From Roughened Surfaces, JOSA 57, 1967,
    doi:10.1364/JOSA.57.001105; in this form R. L. Cook, K. E. Torrance 1982, doi:10.1145/357290.357293.
    """

    def g2(self, distribution: Distribution, wi: Vectors, wo: Vectors, wh: Vectors) -> Floats:
        """Visible and lit share (...) of the facets whose normal is `wh`, whatever the distribution."""
        lower = np.minimum(wi[..., 2], wo[..., 2])
        # VH = LH, and the mean of both has no cancellation at grazing.
        share: Floats = np.minimum(1.0, 4.0 * wh[..., 2] * lower / ((wi + wo) * wh).sum(axis=-1))
        return share


@recipe
class Unmasked:
    """No masking at all, G = 1: to see what masking does. It creates energy, without bound at grazing angles."""

    def g2(self, distribution: Distribution, wi: Vectors, wo: Vectors, wh: Vectors) -> Floats:
        """Ones (...)."""
        return np.ones(np.broadcast_shapes(wi.shape, wo.shape, wh.shape)[:-1])


Masking = Annotated[SmithCorrelated | SmithSeparable | VCavity | Unmasked, Field(discriminator="kind")]
"""What may hide facets from one another."""

CODES = {"Unmasked": 0, "VCavity": 1, "SmithSeparable": 2, "SmithCorrelated": 3}
"""The maskings as kernels know them."""
