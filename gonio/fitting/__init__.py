"""Parameters of a model that describe a measurement best, how sure they are, and which of several models does better.

A fit compares what was counted with what a model would let one count: the energies E of the bins with the model's M.
It minimises the deviance of counts, 2 sum(E ln(E / M) - (E - M)) in units of the noise, by nonlinear least squares of
its roots: where counts are large, these are (E - M) / noise. Unlike measured weights, it does not favour the bins that
happened to be low, and it does not run away from a start far from the truth.

`binning` says what is fitted, `deviance` how far a model is from it, `search` where that is least, `uncertainty` how
sure the parameters are; `regression` puts these together into a `result`, and `ranking` holds several against each
other.

Sources: R. W. M. Wedderburn, Quasi-likelihood functions, Biometrika 61(3), 1974, doi:10.1093/biomet/61.3.439 (noise
known up to a factor); H. White, Maximum likelihood estimation of misspecified models, Econometrica 50(1), 1982,
doi:10.2307/1912526 (errors of a model that is not the truth); K. P. Burnham, D. R. Anderson, Model Selection and
Multimodel Inference, 2002, doi:10.1007/b97636 (QAICc, section 2.5).
"""

from gonio.fitting.ranking import Ranked, rank
from gonio.fitting.regression import fit
from gonio.fitting.result import Fit, Parameter

__all__ = ["Fit", "Parameter", "Ranked", "fit", "rank"]
