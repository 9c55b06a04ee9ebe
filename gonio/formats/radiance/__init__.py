"""Radiance and WINDOW: BSDFs as XML, Klems matrices or tensor trees.

Opens in Radiance (rtrace, rpict, rcontrib ...), pyradiance, Ladybug and Honeybee, accelerad; matrices in WINDOW too.

A `WindowElement` holds one `Layer`; its `WavelengthData` elements hold the numbers, f_r in 1/sr without cosine, as
text. `Visible` is the luminance Y under D65. Colours are two more: `CIE-X` and `CIE-Z` of a matrix, the chromaticities
`CIE-u` and `CIE-v` (u' and v' of 1976) of a tree. White is that of equal energy, as everywhere in Radiance: X, Y and Z
of a neutral surface are equal, ours are scaled to that. Light from above, on the side that the normal +z points to, is
`Reflection Back` in these files and Radiance's front; `Reflection Front` is the other side. `klems` and `tensor_tree`
say how the numbers are ordered and which way their azimuths run. Radiance's rings of the half and quarter bases have
changed over the years: a file defines those that it means, and read here are those, but Radiance goes by the name.

What is lost: a matrix holds means over patches of 10 to 15 degrees (up to 45 in the quarter basis), a tree as written
here means over 64 (rank 3) or 32 (rank 4) cells across the hemisphere, and both are constant within them. Radiance adds
a ripple of 3e-4 to values that it reads and takes their minimum for a Lambertian part, which is left out here. Its
`rttree_reduce` prunes such trees; any tree can be read.

G. Ward, M. Kurt, N. Bonneel, "A Practical Framework for Sharing and Rendering Real-World Bidirectional Scattering
Distribution Functions", LBNL-5954E (2012); J. H. Klems, "A New Method for Predicting the Solar Heat Gain of Complex
Fenestration Systems", ASHRAE Transactions 100(1), 1065-1072 (1994).
"""

from gonio.formats.radiance.reading import read
from gonio.formats.radiance.writing import write

__all__ = ["read", "write"]
