"""How many pairs of directions a second each model evaluates, on one core: median of interleaved repetitions.

    make bench

The order of the models changes from one repetition to the next, so that a slow minute of the machine is no model's own.
"""

from __future__ import annotations

import os
import statistics
import time

import numpy as np
from bench import table

from gonio.models import (
    GGX,
    AshikhminShirley,
    Beckmann,
    CookTorrance,
    Lambert,
    Microfacet,
    OrenNayar,
    PoulinFournier,
    SmithCorrelated,
    SmithMultipleScattering,
    Ward,
)
from gonio.optics import Conductor, Lambertian, Mirror
from gonio.sphere import direction

PAIRS = 1_000_000
WALKED = 1_000
REPETITIONS = 5
GOLD = Conductor("Au")

MODELS = {
    "CookTorrance, F = 1": CookTorrance(m=0.3, material=Mirror()),
    "CookTorrance, gold": CookTorrance(m=0.3, material=GOLD),
    "Microfacet, Beckmann, Smith": Microfacet(distribution=Beckmann(0.3), masking=SmithCorrelated(), material=GOLD),
    "Microfacet, GGX, Smith": Microfacet(distribution=GGX(0.3), masking=SmithCorrelated(), material=GOLD),
    "PoulinFournier, diffuse": PoulinFournier(local=Lambertian(0.8)),
    "PoulinFournier, CookTorrance": PoulinFournier(local=CookTorrance(m=0.3, material=GOLD)),
    "Lambert": Lambert(0.8),
    "OrenNayar": OrenNayar(sigma=20.0),
    "Ward": Ward(alpha=0.2),
    "AshikhminShirley": AshikhminShirley(n=100.0),
    "SmithMultipleScattering, 1000 walks a pair": SmithMultipleScattering(
        distribution=Beckmann(0.3), material=GOLD, walks=1000
    ),
}


def main() -> str:
    """A Markdown table."""
    if hasattr(os, "sched_setaffinity"):  # Linux; elsewhere a model may use more cores
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    random = np.random.default_rng(1)
    theta, phi = random.uniform(0, 89, (2, PAIRS)), random.uniform(0, 360, (2, PAIRS))
    wi, wo = direction(theta[0], phi[0]), direction(theta[1], phi[1])
    rates: dict[str, list[float]] = {name: [] for name in MODELS}
    for repetition in range(REPETITIONS + 1):
        for name in random.permutation(list(MODELS)):
            count = WALKED if "walks" in name else PAIRS
            started = time.perf_counter()
            MODELS[name].eval(wi[:count], wo[:count])
            if repetition:  # the first compiles
                rates[name].append(count / (time.perf_counter() - started) / 1e6)
    rows = [[n, f"{statistics.median(r):.3g}", f"{min(r):.3g} to {max(r):.3g}"] for n, r in rates.items()]
    return table(["model", "M pairs/s, one core, one wavelength", "slowest to fastest"], rows)


if __name__ == "__main__":
    print(main())
