"""The command line: `gonio run | surface | compare | fit | check | validate ...`. Nothing else prints or exits.

Everything heavy is imported inside the command that needs it, so that `gonio --help` answers at once.
Exit codes: 0 done, 1 failed while running, 2 bad input, told in one sentence for each mistake.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from cyclopts import CycloptsError

from gonio.cli import campaigns, exchange, forecasts, judging, measuring, pictures
from gonio.cli.terminal import RunError, app, complain
from gonio.cli.usage import usage
from gonio.toml_files import InputError

__all__ = ["campaigns", "exchange", "forecasts", "judging", "main", "measuring", "pictures"]


def main(tokens: Sequence[str] | None = None) -> NoReturn:
    """Run the command that `tokens` (or the command line) ask for, and exit with its code."""
    code = _attempt(tokens)
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.flush()
        sys.exit(code)
    # The reader of a pipe, such as head, has enough.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def _attempt(tokens: Sequence[str] | None) -> int:
    """Run a command; what can go wrong is told in sentences, everything else is a fault of ours and shows its trace."""
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        return complain(2, usage(error))
    except RunError as error:
        return complain(1, str(error))
    except KeyboardInterrupt:
        return complain(1, "Interrupted.")
    except MemoryError as error:
        return complain(1, f"Not enough memory: {error or 'make the surface, the detector or the run smaller'}.")
    except BrokenPipeError:
        return 0
    except ValueError as error:
        if not isinstance(error, InputError):
            raise
        return complain(2, *error.sentences)
    return 0
