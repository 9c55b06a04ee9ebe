"""Bin averages by an independent rule."""

import numpy as np
from scipy.integrate import nquad


def bin_average(model, wi, grid, index):
    """The average over one bin by subdividing it until a nested rule settles: slow, and nothing in common with ours."""
    ring, sector = np.divmod(index, grid.shape[1])
    low, high = np.radians(grid.theta_edges[ring : ring + 2])
    half, middle = np.radians(grid.phi_step / 2), np.radians(grid.dphi[sector] + 20.0)

    def integrand(phi, theta):
        wo = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        return model.eval(wi, wo)[0] * np.sin(theta) * np.cos(theta)

    options = {"epsabs": 1e-10, "epsrel": 1e-7, "limit": 200}
    total = nquad(integrand, [(middle - half, middle + half), (low, high)], opts=[options, options])[0]
    return total / grid.projected_solid_angles()[index]
