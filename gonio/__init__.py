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

if TYPE_CHECKING:
    from gonio import formats, models, plots
    from gonio.brdf import BRDF
    from gonio.campaign.dataset import open_campaign
    from gonio.comparison import Comparison, compare
    from gonio.detectors import Apertures, HemisphereGrid, Klems
    from gonio.experiment import Experiment
    from gonio.fitting import fit
    from gonio.formats import export, load
    from gonio.goniometer import Goniometer
    from gonio.measurement import Measurement, tabulated
    from gonio.models import CookTorrance, Lambert, Microfacet
    from gonio.netcdf import save
    from gonio.optics import Conductor, Dielectric, Lambertian, Mirror
    from gonio.rendering import render
    from gonio.reporting import report
    from gonio.self_check import check
    from gonio.sphere import direction
    from gonio.toml_files import InputError
    from gonio.transport.scene import Scene
    from gonio.validation import validate

__version__ = "0.1.0"

_HOME = {
    "Apertures": "gonio.detectors",
    "BRDF": "gonio.brdf",
    "InputError": "gonio.toml_files",
    "Conductor": "gonio.optics",
    "CookTorrance": "gonio.models",
    "Dielectric": "gonio.optics",
    "Experiment": "gonio.experiment",
    "Goniometer": "gonio.goniometer",
    "HemisphereGrid": "gonio.detectors",
    "Klems": "gonio.detectors",
    "Lambert": "gonio.models",
    "Lambertian": "gonio.optics",
    "Measurement": "gonio.measurement",
    "Microfacet": "gonio.models",
    "Mirror": "gonio.optics",
    "Scene": "gonio.transport.scene",
    "Comparison": "gonio.comparison",
    "check": "gonio.self_check",
    "compare": "gonio.comparison",
    "export": "gonio.formats",
    "fit": "gonio.fitting",
    "load": "gonio.formats",
    "open_campaign": "gonio.campaign.dataset",
    "render": "gonio.rendering",
    "report": "gonio.reporting",
    "save": "gonio.netcdf",
    "tabulated": "gonio.measurement",
    "direction": "gonio.sphere",
    "validate": "gonio.validation",
}

_MODULES = ("formats", "models", "plots")

__all__ = [
    "BRDF",
    "Apertures",
    "Comparison",
    "Conductor",
    "CookTorrance",
    "Dielectric",
    "Experiment",
    "Goniometer",
    "HemisphereGrid",
    "InputError",
    "Klems",
    "Lambert",
    "Lambertian",
    "Measurement",
    "Microfacet",
    "Mirror",
    "Scene",
    "__version__",
    "check",
    "compare",
    "direction",
    "export",
    "fit",
    "formats",
    "load",
    "models",
    "open_campaign",
    "plots",
    "render",
    "report",
    "save",
    "tabulated",
    "validate",
]


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
