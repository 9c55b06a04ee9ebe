"""How well a model describes a measurement, and how much of the difference is noise.

Models are compared with the light they speak of, most with order 1, the light that hit the surface once; and as what
the instrument measures: averages over the detector's bins. `incidence` is what was measured, `prediction` what a model
says, `pooling` joins bins until they can be judged, `statistics` judges them, `comparison` is the result, and
`sentences` tells it.
"""

from gonio.comparison.comparison import RELATIVE_THRESHOLD, Comparison, compare
from gonio.comparison.pooling import ENOUGH_COUNT
from gonio.comparison.prediction import order_of, predicted

__all__ = ["ENOUGH_COUNT", "RELATIVE_THRESHOLD", "Comparison", "compare", "order_of", "predicted"]
