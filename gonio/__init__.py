"""gonio, a virtual gonioreflectometer: rough surfaces in, measured BRDFs with an error bar on every bin out.

>>> import gonio, microsurfaces as ms
>>> relief = ms.Gaussian(alpha=0.3).build(seed=1)
>>> scene = gonio.Scene(relief, gonio.Conductor("Au"))
>>> measurement = gonio.Goniometer(theta_i=(0, 30, 60)).measure(scene, seed=7)

Names are imported when they are first used, so that `import gonio` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names as in _HOME and _MODULES, for type checkers
    from gonio import formats as formats
    from gonio import models as models
    from gonio import optics as optics
    from gonio import plots as plots
    from gonio.brdf import BRDF as BRDF
    from gonio.campaign.dataset import open_campaign as open_campaign
    from gonio.comparison import Comparison as Comparison
    from gonio.comparison import compare as compare
    from gonio.detectors import Apertures as Apertures
    from gonio.detectors import HemisphereGrid as HemisphereGrid
    from gonio.detectors import Klems as Klems
    from gonio.experiment import Experiment as Experiment
    from gonio.fitting import fit as fit
    from gonio.formats import export as export
    from gonio.formats import load as load
    from gonio.goniometer import Goniometer as Goniometer
    from gonio.measurement import Measurement as Measurement
    from gonio.measurement import tabulated as tabulated
    from gonio.models import GGX as GGX
    from gonio.models import AshikhminShirley as AshikhminShirley
    from gonio.models import Beckmann as Beckmann
    from gonio.models import CookTorrance as CookTorrance
    from gonio.models import Lambert as Lambert
    from gonio.models import Microfacet as Microfacet
    from gonio.models import Mixture as Mixture
    from gonio.models import OrenNayar as OrenNayar
    from gonio.models import PoulinFournier as PoulinFournier
    from gonio.models import SmithCorrelated as SmithCorrelated
    from gonio.models import SmithMultipleScattering as SmithMultipleScattering
    from gonio.models import SmithSeparable as SmithSeparable
    from gonio.models import Unmasked as Unmasked
    from gonio.models import VCavity as VCavity
    from gonio.models import Ward as Ward
    from gonio.netcdf import save as save
    from gonio.optics import Conductor as Conductor
    from gonio.optics import Dielectric as Dielectric
    from gonio.optics import Lambertian as Lambertian
    from gonio.optics import Mirror as Mirror
    from gonio.rendering import render as render
    from gonio.reporting import report as report
    from gonio.self_check import check as check
    from gonio.sphere import direction as direction
    from gonio.toml_files import InputError as InputError
    from gonio.transport.scene import Scene as Scene
    from gonio.validation import validate as validate

__version__ = "0.1.0"

_HOME = {
    "Apertures": "gonio.detectors",
    "AshikhminShirley": "gonio.models",
    "BRDF": "gonio.brdf",
    "Beckmann": "gonio.models",
    "Comparison": "gonio.comparison",
    "Conductor": "gonio.optics",
    "CookTorrance": "gonio.models",
    "Dielectric": "gonio.optics",
    "Experiment": "gonio.experiment",
    "GGX": "gonio.models",
    "Goniometer": "gonio.goniometer",
    "HemisphereGrid": "gonio.detectors",
    "InputError": "gonio.toml_files",
    "Klems": "gonio.detectors",
    "Lambert": "gonio.models",
    "Lambertian": "gonio.optics",
    "Measurement": "gonio.measurement",
    "Microfacet": "gonio.models",
    "Mirror": "gonio.optics",
    "Mixture": "gonio.models",
    "OrenNayar": "gonio.models",
    "PoulinFournier": "gonio.models",
    "Scene": "gonio.transport.scene",
    "SmithCorrelated": "gonio.models",
    "SmithMultipleScattering": "gonio.models",
    "SmithSeparable": "gonio.models",
    "Unmasked": "gonio.models",
    "VCavity": "gonio.models",
    "Ward": "gonio.models",
    "check": "gonio.self_check",
    "compare": "gonio.comparison",
    "direction": "gonio.sphere",
    "export": "gonio.formats",
    "fit": "gonio.fitting",
    "load": "gonio.formats",
    "open_campaign": "gonio.campaign.dataset",
    "render": "gonio.rendering",
    "report": "gonio.reporting",
    "save": "gonio.netcdf",
    "tabulated": "gonio.measurement",
    "validate": "gonio.validation",
}
"""The module of each public name."""

_MODULES = ("formats", "models", "optics", "plots")
"""The modules that are public as such."""

__all__ = ["__version__", *_HOME, *_MODULES]


def __getattr__(name: str) -> Any:
    """Import a public name from its module (PEP 562)."""
    if name in _MODULES:
        return importlib.import_module(f"gonio.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'gonio' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return __all__
