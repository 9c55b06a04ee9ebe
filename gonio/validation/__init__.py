"""The ground truth: what is known exactly of light on rough surfaces, measured by the instrument and judged.

Every case traces surfaces whose reflection follows from a closed form that knows nothing of the tracer, and asks
whether the difference is noise. Where a formula is known to be wrong, the same test must reject it: a test that cannot
fail proves nothing.

Statistics. A surface is measured in `BLOCKS` independent blocks: other random numbers for the light, and other grooves
where the surface is an ensemble. Within a block everything may be stratified, which makes its error smaller than that
of counting; the scatter of the blocks is the honest one. Single numbers are judged by Student's t. Lobes are judged by
the mean over pooled bins of t squared, reduced so that it is 1 if there is nothing but noise (see `reduced_chi2`). All
rows of a case together are wrong about a law that holds with probability `LEVEL` (Sidak): that is their limit, in units
of the score. What is known only as a band, such as the residuals of Smith's model, has a stated bound.
"""

from __future__ import annotations

from collections.abc import Iterable

from gonio.validation.cases import CASES
from gonio.validation.document import markdown, summary
from gonio.validation.judging import Row, judged

__all__ = ["CASES", "Row", "markdown", "summary", "validate"]


def validate(quick: bool = False, cases: Iterable[str] | None = None) -> tuple[Row, ...]:
    """Run the cases of these names, or all of them; `quick` with smaller surfaces and fewer paths.

    A row for every number that was judged. Seeds are fixed: the rows are the same every time. Raises ValueError for a
    name that is no case.
    """
    known = {case.name: case for case in CASES}
    wanted = tuple(known if cases is None else cases)
    if unknown := [name for name in wanted if name not in known]:
        raise ValueError(f"case {unknown[0]!r} is not known: choose from {', '.join(map(repr, known))}")
    return tuple(row for name in wanted for row in judged(known[name], quick))
