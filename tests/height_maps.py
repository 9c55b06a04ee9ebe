"""Height maps that have no symmetry, and writers of their files."""

import zipfile

import numpy as np
import OpenEXR

from microsurfaces import HeightField, HeightFieldFile

# Levels of grey; seen as an image, row 0 is the top. The surface has them the other way up.
IMAGE = np.array([[10, 20, 30, 40], [11, 12, 13, 14], [900, 1, 65535, 7]])

LEVELS = IMAGE[::-1]

CHIRAL = HeightField(LEVELS * 1e-3 + 0.1, (0.5, 2.0))


def read(path, **given):
    return HeightFieldFile(
        **{"path": str(path), "pixel_size": 1.0, "unit": "um", "periodic": "as is", "scale": 1.0} | given
    ).build(0)


def write_exr(path, channels, **attributes):
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, **attributes}
    OpenEXR.File(header, {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}).write(str(path))


def cut(path, write, share):
    write(path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


def x3p(path, main, members=(), packed=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", packed) as archive:
        archive.writestr("main.xml", main)
        for name, content in dict(members).items():
            archive.writestr(name, bytes(content))


def main_xml(record3, cz="<DataType>D</DataType>", feature="SUR", axis="I", size=(4, 3, 1), head="", step="5e-7"):
    """A main.xml as ISO 25178-72 has it, of 4 x 3 points 0.5 µm and 2 µm apart."""
    x, y, z = size
    return f"""<?xml version="1.0" encoding="UTF-8"?>{head}
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2"><Record1><Revision>ISO25178-72:2017/DAM1</Revision>
<FeatureType>{feature}</FeatureType><Axes>
<CX><AxisType>{axis}</AxisType><DataType>D</DataType><Increment>{step}</Increment><Offset>0.0</Offset></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>2.0E-0006</Increment></CY>
<CZ><AxisType>A</AxisType>{cz}</CZ></Axes></Record1>
<Record3><MatrixDimension><SizeX>{x}</SizeX><SizeY>{y}</SizeY><SizeZ>{z}</SizeZ></MatrixDimension>{record3}</Record3>
<Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4></p:ISO5436_2>"""


LINK = "<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink>"

VALID = LINK.replace("</DataLink>", "<ValidPointsLink>bindata/valid.bin</ValidPointsLink></DataLink>")

LIST = "<DataList>" + "".join(f"<Datum>{z}</Datum>" for z in LEVELS.ravel()) + "</DataList>"

ALL = np.packbits(np.ones(12, bool), bitorder="little").tobytes()


def z_axis(kind, step="1", offset="0"):
    return f"<DataType>{kind}</DataType><Increment>{step}</Increment><Offset>{offset}</Offset>"


X3P = {
    "float64": (main_xml(LINK), {"bindata/data.bin": LEVELS.astype("<f8")}),
    "float32": (main_xml(LINK, z_axis("F")), {"bindata/data.bin": LEVELS.astype("<f4")}),
    "int32": (main_xml(LINK, z_axis("L", "0.5", "-3")), {"bindata/data.bin": (2 * LEVELS + 6).astype("<i4")}),
    "int16": (
        main_xml(VALID, z_axis("I", "1.0E+0000", "32768")),
        {"bindata/data.bin": (LEVELS - 32768).astype("<i2"), "bindata/valid.bin": ALL},
    ),
    "text": (main_xml(LIST), {}),
}
