"""What is wrong with a command line, in one sentence that says what to write instead."""

from __future__ import annotations

from collections.abc import Iterable

from cyclopts import CycloptsError
from cyclopts.exceptions import (
    CoercionError,
    ConsumeMultipleError,
    MissingArgumentError,
    RepeatArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

TYPES = {int: "a whole number", float: "a number"}
"""What options take that is not text."""

OTHER_WORDS = {"-o": "--to", "--output": "--to", "--to": "--output"}
"""--output is a folder, --to a file; who took one for the other is told so."""


def usage(error: CycloptsError) -> str:
    """The sentence for `error`."""
    command = " ".join(("gonio", *(error.command_chain or ())))
    see = f"{command} --help shows what it takes"
    match error:
        case UnknownCommandError():
            return _unknown_command(error)
        case UnknownOptionError():
            option = error.token.keyword or error.token.value
            known = {name for each in error.argument_collection if each.parse for name in each.names}
            return f"{option}: {command} has no such option{_suggestion(option, known) or f'; {see}'}"
        case CoercionError(token=token, target_type=kind) if token is not None and kind in TYPES:
            return f"{token.keyword} {token.value}: must be {TYPES[kind]}"
        case CoercionError(token=token, target_type=kind) if token is not None and kind is bool:
            return f"{token.keyword} takes no value"
        case MissingArgumentError(argument=argument) if argument is not None:
            if isinstance(error, ConsumeMultipleError) or error.keyword or argument.tokens:
                return f"{error.keyword or argument.name}: its value is missing; {see}"
            where = "" if argument.name.startswith("-") else ", which comes before the options"
            return f"{command} needs {argument.name}{where}; {see}"
        case RepeatArgumentError(token=token):
            return f"{token.keyword}: given twice, or with its opposite; {command} takes it once"
        case UnusedCliTokensError(unused_tokens=unused):
            return (
                f"{' '.join(unused or ())}: belongs to no option of {command}; put quotes around what has spaces, and "
                "repeat an option for each of its values"
            )
    return f"{' '.join(str(error).split()).rstrip('.')}; {see}"


def _unknown_command(error: UnknownCommandError) -> str:
    """The sentence for what is no command."""
    name = " ".join(error.app.name) if error.app else "gonio"
    group = name if name == "gonio" else f"gonio {name}"
    word = error.unused_tokens[0] if error.unused_tokens else ""
    known = [each for each in error.app or () if not each.startswith("-")]
    kind = "option" if word.startswith("-") else "command"
    return f"{word}: {group} has no such {kind}{_suggestion(word, known) or f'; {group} --help shows them'}"


def _suggestion(word: str, known: Iterable[str]) -> str:
    """The question after a misspelt word, or nothing."""
    from microsurfaces.recipe import did_you_mean

    names = sorted(known)
    if OTHER_WORDS.get(word) in names:
        return f"; did you mean {OTHER_WORDS[word]}?"
    return did_you_mean(word, names)
