"""Lists of bins by plain readers of text and JSON.

Every row is theta_i, phi_i, theta_o, phi_o in degrees, the wavelength in nm and the value in 1/sr.
"""

import csv
import io
import json
import math


def rows_of_csv(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    for row in csv.DictReader(lines):
        turn = float(row["phi_i"]) + float(row["dphi"]) - float(row["phi_o"])
        assert abs((turn + 180) % 360 - 180) < 1e-9
        yield (*(float(row[n]) for n in ("theta_i", "phi_i", "theta_o", "phi_o", "wavelength")), float(row["brdf"]))


def rows_of_astm(path):
    """As libbsdf's reader goes about it: words until VARS, then lines of numbers, angles in radians."""
    stream = io.StringIO(path.read_text())
    for line in stream:
        if "VARS" in line.split():
            break
    names = line.removeprefix("VARS ").strip().split(",")
    assert names[:4] == ["theta_i", "phi_i", "theta_r", "phi_r"]
    for line in stream:
        numbers = [float(number) for number in line.split(",")]
        for name, value in zip(names[4:], numbers[4:], strict=True):
            yield (*(math.degrees(angle) for angle in numbers[:4]), float(name.removesuffix("nm")), value)


def rows_of_bird(path):
    data = json.loads(path.read_text())["data"]
    assert all(data[n]["unit"] == "deg" for n in ("theta_i", "phi_i", "theta_r", "phi_r"))
    lists = (data[n]["values"] for n in ("theta_i", "phi_i", "theta_r", "phi_r", "wavelength_i", "BRDF"))
    yield from zip(*lists, strict=True)


def rows_of_xompt(path):
    for metres, theta_i, theta_o, phi, value in json.loads(path.read_text())["brdf"]["lookupTable"]:
        yield (math.degrees(theta_i), 0.0, math.degrees(theta_o), math.degrees(phi), 1e9 * metres, value)


READERS = {"csv": rows_of_csv, "astm": rows_of_astm, "bird": rows_of_bird, "xompt": rows_of_xompt}
