"""Draws the pictures of the README: what `make gallery` runs. Two or three minutes."""

import tempfile
from pathlib import Path

from PIL import Image

import gonio
import microsurfaces as ms
from gonio import plots

FOLDER = Path(__file__).parent / "gallery"
WIDTH, COLOURS = 1200, 192
SHADED = ("lobes", "sphere", "relief")
RELIEF = ms.Gaussian(alpha=0.3, correlation_length=10.0, side=600.0, samples=640)
GOLD = gonio.Conductor("Au")


def shrunk(source: Path) -> None:
    """Put a picture into the gallery at a page's width: drawings in few colours, shaded bodies as photographs are."""
    image = Image.open(source).convert("RGB")
    image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    if source.stem in SHADED:
        image.save(FOLDER / f"{source.stem}.jpg", quality=90, optimize=True)
    else:
        image.quantize(COLOURS, dither=Image.Dither.NONE).save(FOLDER / source.name, optimize=True)


def main() -> None:
    """Measure rough gold, and draw everything."""
    FOLDER.mkdir(exist_ok=True)
    built = RELIEF.build(1)
    goniometer = gonio.Goniometer(
        theta_i=(0.0, 16.0, 30.0, 46.0, 60.0, 74.0, 84.0), paths=8_000_000, detector=gonio.HemisphereGrid(2.0, 3.0)
    )
    gold = goniometer.measure(gonio.Scene(built, GOLD), seed=1)
    model = gonio.CookTorrance(m=built.statistics().beckmann_alpha, material=GOLD)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plots.relief(RELIEF, folder / "relief.png", seed=1)
        plots.paths(ms.VGrooves(angle=40.0), folder / "paths.png", theta_i=30.0)
        plots.albedo(gold, folder / "albedo.png", models=[model])
        plots.sphere(gold, folder / "sphere.png", models=[model])
        plots.hemisphere(gold, folder / "hemisphere.png")
        plots.lobes(gold, folder / "lobes.png", models=[model])
        for picture in folder.glob("*.png"):
            shrunk(picture)


if __name__ == "__main__":
    main()
