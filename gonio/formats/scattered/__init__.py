"""Lists of samples of a BRDF, as most files of measurements hold them, and the function that they stand for.

A list is a measurement as it is if its directions are the bin centres of a `HemisphereGrid` and every incidence is
there; what a file leaves out of it stays unknown (NaN). Any other list is interpolated: linearly in theta_o and dphi
where the directions of an incidence form rings and sectors, linearly over the triangles between them where they are
scattered. Between incidences the lobe moves with the half vector. A direction farther from all samples than half their
distance is unknown, and so are azimuths in a gap of more than 60 degrees: samples in the plane of incidence say nothing
about the directions outside of it.
"""
