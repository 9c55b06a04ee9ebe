"""A matplotlib figure that notebooks show by itself: imported where figures are made, because it imports matplotlib."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A figure that no pyplot knows: a notebook shows it where a cell ends with it, and forgets it with the
    variable."""

    def _repr_png_(self) -> bytes:
        """The picture, as IPython asks for it."""
        content = io.BytesIO()
        self.savefig(content, format="png")
        return content.getvalue()
