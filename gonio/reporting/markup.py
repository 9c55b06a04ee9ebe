"""HTML as a tree of elements: whatever text is put into it is escaped when it is written, none can become markup."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, tostring

if TYPE_CHECKING:
    from rich.table import Table

Node = Element | str | None
"""What elements consist of; None is left out."""

_CONTROLS = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")
"""Characters that no HTML text may hold."""

_JUDGED = {"green": "passed", "yellow": "warning", "bold red": "failed"}
"""Classes of rows that stand out on a terminal, by their style there."""


def clean(text: object) -> str:
    """`text` without characters that HTML does not know."""
    return _CONTROLS.sub("\ufffd", str(text))


def tag(name: str, /, *children: Node, **attributes: str) -> Element:
    """An element; `class_` and `for_` stand for class and for, `data_x` for data-x."""
    element = Element(name, {key.rstrip("_").replace("_", "-"): clean(value) for key, value in attributes.items()})
    for child in children:
        if isinstance(child, Element):
            element.append(child)
        elif child and len(element):
            element[-1].tail = (element[-1].tail or "") + clean(child)
        elif child:
            element.text = (element.text or "") + clean(child)
    return element


def paragraphs(*texts: str) -> list[Element]:
    """A paragraph for each text that is not empty."""
    return [tag("p", text) for text in texts if text]


def script(code: str, **attributes: str) -> Element:
    """Code of our own or of a library. Raises ValueError if it would end its own element."""
    if "</script" in code.lower() or "<!--" in code:
        raise ValueError("a script with </script or <!-- in it cannot be part of a page")
    element = Element("script", attributes)
    element.text = code
    return element


def data(identifier: str, content: Any) -> Element:
    """`content` as JSON that scripts of the page can read, and that cannot end its element."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    element = Element("script", {"type": "application/json", "id": identifier})
    element.text = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return element


def table(source: Table, caption: str) -> Element:
    """A table made for a terminal, the same words and numbers, in a box that scrolls where the screen is narrow."""
    head = tag("tr", *(tag("th", str(column.header), scope="col", class_=column.justify) for column in source.columns))
    body = tag("tbody", *_rows(source))
    whole = tag("table", tag("caption", caption), tag("thead", head), body)
    note = tag("p", str(source.caption), class_="note") if source.caption else None
    return tag("div", tag("div", whole, class_="scroll", tabindex="0", role="region", aria_label=caption), note)


def _rows(source: Table) -> Iterator[Element]:
    for row, cells in zip(source.rows, zip(*(column.cells for column in source.columns), strict=True), strict=True):
        first, *others = (
            tag("th" if k == 0 else "td", str(cell), class_=column.justify, **({"scope": "row"} if k == 0 else {}))
            for k, (cell, column) in enumerate(zip(cells, source.columns, strict=True))
        )
        judged = _JUDGED.get(str(row.style))
        yield tag("tr", first, *others, **({"class_": judged} if judged else {}))


def page(root: Element) -> str:
    """The document."""
    return "<!DOCTYPE html>\n" + tostring(root, encoding="unicode", method="html") + "\n"
