"""Which codec a file gets: by its name, the option, or its content."""

import re

import numpy as np
import pytest

from msal_cli.codecs import open_mesh
from msal_cli.codecs.conversion import convert
from msal_cli.codecs.detection import content_format, format_of_name
from msal_cli.codecs.header import read_header
from msal_cli.errors import FormatError, TruncatedError, UnsupportedError
from msal_cli.job import room
from tests.codecs import plain_stl
from tests.codecs.plain_stl import tetrahedron
from tests.ply_files import XYZ, to_ascii_ply

TEXTS = {
    "a.ply": to_ascii_ply(XYZ, ["0 0 0", "1{0}5 0 0", "0 1 0"]).decode(),
    "a.obj": "v 0 0 0\nv 1{0}5 0 0\nv 0 1 0\nf 1 2 3\n",
    "a.off": "OFF\n3 1 0\n0 0 0\n1{0}5 0 0\n0 1 0\n3 0 1 2\n",
    "a.stl": "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1{0}5 0 0\n"
    "vertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
}
"""A triangle; the place of {0} is that of a decimal point."""

PLY, OBJ, OFF, STL_TEXT = (text.format(".").encode() for text in TEXTS.values())
STL = plain_stl.binary(tetrahedron())
GLB, GLTF = (bytes(convert(open_mesh(OBJ, "a.obj"), np.eye(3), to)[0]) for to in ("glb", "gltf"))
FILES = {"ply": PLY, "obj": OBJ, "stl": STL, "off": OFF, "glb": GLB, "gltf": GLTF}


@pytest.mark.parametrize("kind", FILES)
def test_suffixes_in_any_case_and_before_gz(kind):
    for name in (f"a.{kind}", f"A.{kind.upper()}", f"x/y.z/a.b.{kind}", f"a.{kind}.gz"):
        assert format_of_name(name) == kind
        assert open_mesh(FILES[kind], name).format == kind


@pytest.mark.parametrize(
    "name", ["", "-", "a", ".ply", "a.txt", "a.gz", "ply", "a.ply/b", "a.ply."]
)
def test_names_without_a_format(name):
    assert format_of_name(name) == ""


@pytest.mark.parametrize("kind", [*FILES, "ascii stl"])
def test_a_stream_is_known_by_its_content(kind):
    data = STL_TEXT if kind == "ascii stl" else FILES[kind]
    for name in ("-", "", "scan", "folder.d/scan"):
        assert open_mesh(data, name).format == kind.split()[-1]


@pytest.mark.parametrize("wrong", FILES)
@pytest.mark.parametrize("kind", FILES)
def test_a_wrong_suffix_is_named(kind, wrong):
    if kind == wrong:
        return
    with pytest.raises(FormatError) as caught:
        open_mesh(FILES[kind], f"scan.{wrong}")
    if (kind, wrong) != ("obj", "off"):  # an OBJ file is known less surely
        assert kind.upper() in str(caught.value)
        assert f"--format {kind}" in caught.value.hint
        with pytest.raises(FormatError) as caught:
            open_mesh(FILES[kind], "standard input", wrong)
        assert "rename" not in caught.value.hint


def test_the_option_overrules_the_name_but_not_the_content():
    assert open_mesh(PLY, "scan.stl", "ply").format == "ply"
    assert open_mesh(PLY, "scan.txt", ".PLY").format == "ply"
    with pytest.raises(FormatError, match="--format says STL"):
        open_mesh(PLY, "scan.ply", "stl")


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.stl", "a.glb", "a.off", "a.vtk", "-", "a"])
def test_empty_files(name):
    with pytest.raises(TruncatedError, match="empty"):
        open_mesh(b"", name)


@pytest.mark.parametrize(
    ("text", "encoding", "what", "hint"),
    [("\ufeffply\n", f"utf-16-{end}", "UTF-16", "UTF-8") for end in ("le", "be")]
    + [("version https://git-lfs.github.com/spec/v1\n", "ascii", "Git LFS", "git lfs pull")],
)
@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.stl", "a.vtk", "a.gltf", "a.ply.gz", "a"])
def test_what_is_no_mesh_is_said_to_be_that(name, text, encoding, what, hint):
    data = text.encode(encoding)
    with pytest.raises(FormatError, match=what) as caught:
        room.open_mesh(data, name)
    assert hint in caught.value.hint
    assert what in str(read_header(name[2:], data, len(data)).error)


def test_suffixes_that_are_not_read():
    with pytest.raises(UnsupportedError, match=r"\.txt") as caught:
        open_mesh(PLY, "scan.txt")
    assert "--format ply" in caught.value.hint
    with pytest.raises(UnsupportedError) as caught:
        open_mesh(b"Kaydara FBX Binary", "scan.fbx")
    assert "known are" in caught.value.hint
    with pytest.raises(UnsupportedError, match="not known"):
        open_mesh(PLY, "scan.ply", "fbx")


@pytest.mark.parametrize(
    ("data", "format"),
    [
        (b"o part\nv 0 0 0\n", "obj"),
        (b"\xef\xbb\xbfv 0 0 0\n", "obj"),
        (b"mtllib a.mtl\r\nv -1.5e-3 .5 +2\r\n", "obj"),
        (b"v\t0\t0\t0\nf 1 \\\n1 1\n", "obj"),
        (b"v 0 0 0\n" * 20_000, "obj"),
        *((text, "") for text in (b"value 1 2 3\n", b"v 1 2\n", b"v 0 0 0\nhello\n", b"f 1 2 3\n")),
        # Two ways to read every digit would make two billion of this.
        (b"v " + b"1" * 60_000 + b"\n", ""),
    ],
)
def test_obj_by_its_lines(data, format):
    assert content_format(data) == format


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.msh", b"$MeshFormat\n"),
        ("part.MESH", b" MeshVersionFormatted 2\n"),
        ("a.inp", b"*HEADING\n"),
        ("a.inp.gz", PLY),
        ("a.med", b"\x89HDF\r\n"),
        ("a.3ds", b"MM"),
        ("lh.gii", b"<GIFTI>"),
        ("a.dae", b"<?xml version='1.0'?>\n<!-- <VTKFile> -->\n<COLLADA xmlns='x'>"),
        ("-", b"<?xml version='1.0'?><!DOCTYPE Xdmf SYSTEM 'Xdmf.dtd' []>\n<Xdmf>"),
        ("scan.ply", b"$MeshFormat\n"),
        ("scan.vtu", b"\xef\xbb\xbf<COLLADA>"),
        ("scan.obj", b"MeshVersionFormatted 2\n"),
        ("empty.vol", b""),
    ],
)
def test_formats_that_another_program_converts(name, content):
    with pytest.raises(UnsupportedError, match="files are not read") as caught:
        open_mesh(content, name)
    assert caught.value.code == "E_UNSUPPORTED"
    assert re.search(r"meshio convert \S+ mesh\.ply|Blender|FreeSurfer", caught.value.hint)
    with pytest.raises(UnsupportedError, match="cannot be written"):
        convert(open_mesh(PLY, "a.ply"), np.eye(3), "msh")


@pytest.mark.parametrize("name", TEXTS)
def test_a_decimal_comma_is_named(name):
    assert len(open_mesh(TEXTS[name].format(".").encode(), name).faces) == 1
    for mark, is_named in ((",", True), ("x", False)):
        with pytest.raises(FormatError, match=f"1{mark}5") as caught:
            open_mesh(TEXTS[name].format(mark).encode(), name)
        assert caught.value.hint
        assert ("not a comma" in caught.value.hint) is is_named
