"""RGL's tensor files (.bsdf): Mitsuba 3 `measured`, pbrt-v4 `measured`, Tekari, powitacq, BSDFProcessor.

The format of EPFL's material database. A BRDF is stored as what remains of it beside a microfacet model: with the half
vector m of wi and wo, a distribution of normals D and its projected area sigma,

    f(wi, wo) cos(theta_o) = S(x, y; wi) D(m) / (4 sigma(wi))

The table S is smooth where f is not, and stands on a square that is warped, for each incidence, so that the nodes lie
close where the lobe is. Any positive D and any warp are exact at the nodes; good ones make S flat between them.

**Container.** `tensor_file\\0`, version 1.0, the number of fields, then for each its name, dimensions, type, offset and
shape; payloads are aligned to 8 bytes, little endian, the last index fastest.

**Fields**, float32. `theta_i` (T) and `phi_i` (P), radians, ascending; one or two azimuths mean an isotropic BRDF,
otherwise they span 2 pi / r, and r = 2 and r = 4 stand for a half turn and for two mirror planes. `ndf`, `sigma`: D and
sigma on a square of rows v = (phi + pi) / 2 pi and columns u = sqrt(2 theta / pi). `vndf` (P, T, v, u): the density of
the nodes on the same square of m, of which phi is counted from phi_i in isotropic files. `luminance` (P, T, y, x): what
samplers multiply it by. `rgb` (P, T, 3, y, x), or `spectra` (P, T, wavelength, y, x) with `wavelengths` in nm: S at
x, y = 0 ... 1, the marginal and conditional distribution functions of `vndf`. `jacobian` (1 here; 0: S is f cos itself)
and `valid` (bits: nodes above the horizon of which something is known) are bytes, `description` is UTF-8.

**What is written.** D is the mean over incidences of 4 f cos(theta_i) cos(theta_o), so that S stays within few powers
of ten whatever the lobe: a diffuse part or multiple scattering has its place in D. The nodes are not spread as visible
normals are: a share of them evenly over the square, and few below the horizon. The sampling density follows the BRDF
all the same, by `luminance`. Between the known incidences there are as many as it takes; azimuths go all around
(r = 1), because only Mitsuba knows other reductions.

**What is lost.** Values below 0 of a colour; everything finer than the nodes, in lobes narrower than about 2 degrees
first; f (not f cos) within a degree of the horizon, where nodes below it hold 0 and it comes out too large. Mitsuba
leaves r of an isotropic file to chance, so that its rows of sigma must be equal, as ours are. Readers hold the first
and the last theta_i beyond them. A renderer that starts at the eye takes wi for the viewer and wo for the light, which
is the same for a reciprocal BRDF. The colour variant opens in RGB programs only, the spectral variant (pbrt-v4's) in
spectral ones.

Source: J. Dupuy and W. Jakob, An Adaptive Parameterization for Efficient Material Acquisition and Rendering, ACM
Transactions on Graphics 37(6), 2018, doi:10.1145/3272127.3275059; https://github.com/rgl-epfl/brdf-loader.
"""

from gonio.formats.rgl.reading import read
from gonio.formats.rgl.writing import write

__all__ = ["read", "write"]
