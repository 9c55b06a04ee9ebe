"""What a notebook shows of a thing: a small picture and key numbers in HTML, without anything from outside."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

LONGEST = 160
"""Characters of a text, beyond which it is cut."""


def html_card(title: str, rows: Mapping[str, object], picture: str = "") -> str:
    """HTML of `picture` (an element, see `image`) beside a table of `rows`; title and rows are text and get escaped."""
    cell = "padding:1px 12px 1px 0;text-align:left;vertical-align:top"
    table = "".join(
        f'<tr><td style="{cell};opacity:0.65">{_text(name)}</td><td style="{cell}">{_text(value)}</td></tr>'
        for name, value in rows.items()
    )
    return (
        '<div style="display:flex;gap:18px;align-items:flex-start;font:13px/1.45 sans-serif">'
        f'<div>{picture}</div><div><div style="font-weight:600;margin-bottom:4px">{_text(title)}</div>'
        f'<table style="border-collapse:collapse;margin:0">{table}</table></div></div>'
    )


def image(pixels: NDArray[np.uint8], words: str) -> str:
    """An element that shows `pixels`, grey (rows, columns) or RGB (rows, columns, 3); `words` for those who cannot
    see it."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG", optimize=True)
    content = base64.b64encode(file.getvalue()).decode()
    return f'<img alt="{html.escape(words)}" title="{html.escape(words)}" src="data:image/png;base64,{content}">'


def _text(value: object) -> str:
    """Escaped, in one line, not too long."""
    text = " ".join(str(value).split())
    return html.escape(text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…")
