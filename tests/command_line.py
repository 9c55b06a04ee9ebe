"""The command line as tests call it, and a small experiment for it."""

import pytest

from gonio.cli import main

TOY = """
title = "A toy"
realisations = 2
[surface]
kind = "Gaussian"
alpha = 0.3
side = 100.0
samples = 32
[material]
kind = "Conductor"
name = "Au"
[goniometer]
theta_i = [0.0, 30.0]
paths = 400
replicates = 4
detector = {kind = "HemisphereGrid", theta_step = 10.0, phi_step = 20.0}
"""


def called(capsys, *tokens):
    """Exit code, stdout and stderr of `gonio` with these words."""
    with pytest.raises(SystemExit) as exit_:
        main(tuple(map(str, tokens)))
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    assert "Traceback" not in err
    return exit_.value.code, out, err
