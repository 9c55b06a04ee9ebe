"""ISO 25178-72: every type of it is read, and what is bad or hostile is one sentence."""

import struct
import zipfile

import numpy as np
import pytest
from height_maps import LEVELS, LINK, LIST, VALID, X3P, main_xml, x3p, z_axis

from microsurfaces import HeightFieldFile


@pytest.mark.parametrize("name", X3P)
def test_x3p_of_every_type_is_read_by_the_standard_with_the_first_row_at_the_lowest_y(tmp_path, name):
    x3p(tmp_path / "a.x3p", *X3P[name])
    field = HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)
    np.testing.assert_allclose(field.heights, LEVELS * 1e6, rtol=1e-15)
    assert field.spacing == pytest.approx((0.5, 2.0), rel=1e-15)


ALL_BUT_THE_SEVENTH = np.packbits(np.arange(12) != 6, bitorder="little").tobytes()


def test_gaps_of_x3p_are_counted_whether_marked_by_bits_nan_or_empty_text(tmp_path):
    levels = LEVELS.astype("<i4")
    gap = np.where(np.arange(12).reshape(3, 4) == 6, np.nan, LEVELS)
    for main, members in (
        (main_xml(VALID, z_axis("L")), {"bindata/data.bin": levels, "bindata/valid.bin": ALL_BUT_THE_SEVENTH}),
        (main_xml(LINK), {"bindata/data.bin": gap}),
        (main_xml(LIST.replace(f"<Datum>{LEVELS[1, 2]}</Datum>", "<Datum/>")), {}),
    ):
        x3p(tmp_path / "a.x3p", main, members)
        with pytest.raises(ValueError, match="1 of 12 heights are NaN or infinite: fill the gaps of the map first"):
            HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)


def bomb(size):
    """A deflated member of `size` zeros that is a thousandth as large, with its size as it is in the directory."""
    return bytes(size)


BILLION_LAUGHS = "<!DOCTYPE x [" + "".join(
    f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "ha"}">' for i in range(10)
) + "]>"  # fmt: skip

HEIGHTS = {"bindata/data.bin": LEVELS.astype("<f8")}

BAD_X3P = {
    "no main.xml": (("", {}), "File is not a zip file|no item named"),
    "empty main.xml": (("", {}), "no element found"),
    "profile": ((main_xml(LINK, feature="PRF"), HEIGHTS), "it holds PRF I I A 1, not a surface on a regular grid"),
    "irregular": ((main_xml(LINK, axis="A"), HEIGHTS), "it holds SUR A I A 1, not a surface"),
    "layers": ((main_xml(LINK, size=(4, 3, 2)), HEIGHTS), "it holds SUR I I A 2, not a surface"),
    "type": ((main_xml(LINK, z_axis("Q")), HEIGHTS), "'Q'"),
    "no type": ((main_xml(LINK, ""), HEIGHTS), "has no Record1/Axes/CZ/DataType"),
    "step": ((main_xml(LINK, step="0"), HEIGHTS), "its increments are 0, 2e-06 and 1 m"),
    "nan step": ((main_xml(LINK, step="nan"), HEIGHTS), "its increments are nan, 2e-06 and 1 m"),
    "size": ((main_xml(LINK, size=("9" * 5000, 3, 1)), HEIGHTS), "digits"),
    "many": ((main_xml(LINK, size=(10**6, 10**6, 1)), HEIGHTS), "1000000 x 1000000 pixels: more than 67108864 nodes"),
    "negative": ((main_xml(LINK, size=(-4, -3, 1)), HEIGHTS), "-4 x -3 pixels: expected at least 2 x 2"),
    "short": ((main_xml(LINK), {"bindata/data.bin": bytes(88)}), "it holds 11 of 12 heights"),
    "long": ((main_xml(LINK), {"bindata/data.bin": bytes(104)}), "unpacks to 104 bytes, more than 96"),
    "no data": ((main_xml(LINK), {}), "no item named 'bindata/data.bin' in the archive"),
    "few": ((main_xml(LIST.replace("<Datum>1</Datum>", "")), {}), "it holds 11 of 12 heights"),
    "words": ((main_xml(LIST.replace("<Datum>1</Datum>", "<Datum>one</Datum>")), {}), "could not convert string"),
    "valid": (
        (main_xml(VALID), HEIGHTS | {"bindata/valid.bin": bytes(1)}),
        "it holds 8 bits of validity for 12 heights",
    ),
    "bomb of data": ((main_xml(LINK), {"bindata/data.bin": bomb(1 << 28)}), "unpacks to 268435456 bytes, more than 96"),
    "bomb of text": ((bomb(1 << 28), {}), "main.xml unpacks to 268435456 bytes, more than 67108864"),
    "laughs": ((main_xml(LIST, head=BILLION_LAUGHS, feature="&a9;"), {}), "its main.xml defines a document type"),
    "depth": (("<a>" * 10**6, {}), "its main.xml is nested too deeply"),
    "lzma": ((main_xml(LINK), HEIGHTS, zipfile.ZIP_LZMA), "its main.xml is packed neither plain nor by deflate"),
}


@pytest.mark.parametrize("name", BAD_X3P)
def test_a_bad_or_hostile_x3p_is_one_sentence(tmp_path, name):
    content, sentence = BAD_X3P[name]
    x3p(tmp_path / "a.x3p", *content)
    if name == "no main.xml":
        zipfile.ZipFile(tmp_path / "a.x3p", "w").close()
    with pytest.raises(ValueError, match=sentence) as error:
        HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)
    assert str(error.value).startswith(str(tmp_path / "a.x3p"))
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_a_member_that_lies_about_its_size_is_cut_where_the_directory_says(tmp_path):
    x3p(tmp_path / "a.x3p", main_xml(LINK), {"bindata/data.bin": bomb(1 << 26)})
    lie = (tmp_path / "a.x3p").read_bytes().replace(struct.pack("<I", 1 << 26), struct.pack("<I", 96))
    (tmp_path / "a.x3p").write_bytes(lie)
    with pytest.raises(ValueError, match="Bad CRC-32"):
        HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)
