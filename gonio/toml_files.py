"""TOML files that say in sentences what is wrong with them."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class InputError(ValueError):
    """What was given cannot be run. `sentences` has one for each mistake: key, value, what was expected, what to do."""

    def __init__(self, *sentences: str) -> None:
        """An error of these sentences."""
        super().__init__("\n".join(sentences))
        self.sentences = sentences


def read_toml(path: Path, needs: str) -> dict[str, Any]:
    """The tables of a TOML file; `InputError` if there are none, with what it `needs`."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file{_nearby(path)}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder: give a TOML file.") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not text: an experiment is a TOML file in UTF-8.") from None
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message, _, place = str(error).removesuffix(")").rpartition(" (at ")
        raise InputError(f"{path}, {place}: {message[0].lower()}{message[1:]}.") from None
    except RecursionError:
        raise InputError(f"{path}: lists or tables are nested too deeply.") from None
    if not table:
        raise InputError(f"{path} is empty: {needs}.")
    return table


def _nearby(path: Path) -> str:
    """A question that names the file probably meant, or a full stop."""
    names = [other.name for other in path.parent.glob("*.toml")] if path.parent.is_dir() else []
    near = difflib.get_close_matches(path.with_suffix(".toml").name, names, n=1)
    return f"; did you mean {path.with_name(near[0])}?" if near else "."


def override_value(table: dict[str, Any], override: str) -> list[str]:
    """Put "key.key=value" into `table`; the mistakes in it, as sentences."""
    key, equals, text = (part.strip() for part in override.partition("="))
    if not equals or not re.fullmatch(r"[\w-]+(\.[\w-]+)*", key) or not text:
        return [f"--set {override!r}: must be key=value, such as surface.alpha=0.2."]
    *parents, name = key.split(".")
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            return [f"--set {override!r}: {parent} is a value, not a table."]
    table[name] = from_toml(text)
    return []


def resolve_paths(table: Mapping[str, Any], folder: Path) -> None:
    """Make every `path` in the surface's table absolute, in place; relative ones are beside the TOML file."""
    for child in table.values():
        if isinstance(child, dict):
            if isinstance(child.get("path"), str):
                child["path"] = str(folder / child["path"])
            resolve_paths(child, folder)


def kind_first(table: dict[str, Any]) -> dict[str, Any]:
    """The same table with its kind on top."""
    ordered = {"kind": table["kind"]} | table if "kind" in table else table
    return {key: kind_first(value) if isinstance(value, dict) else value for key, value in ordered.items()}


def from_toml(text: str) -> Any:
    """`text` read as a TOML value, .5 and 5. as numbers; what is none, such as a bare word, is text."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return float(text) if re.fullmatch(r"[+-]?(\d+\.|\.\d+)", text) else text
    return parsed["value"] if len(parsed) == 1 else text
