"""Which files can be read in pieces, and how compressed ones are."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs import open_mesh
from msal_cli.codecs.streamed import open_streamed
from msal_cli.errors import InputError, MsalError, OutputError, UnsupportedError
from msal_cli.storage.gzip_streams import compress
from tests.codecs import plain_stl
from tests.codecs.plain_ply import ENCODINGS, Element, Ply, written


def tetrahedron(encoding: str) -> bytes:
    vertex = Element(
        "vertex",
        [(name, "float", "") for name in "xyz"],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    )
    face = Element("face", [("vertex_indices", "int", "uchar")], [[[0, 1, 2]], [[0, 1, 3]]])
    return written(Ply(encoding, [vertex, face]))


FILES = {
    "binary.ply": tetrahedron(ENCODINGS[1]),
    "text.ply": tetrahedron("ascii"),
    "text.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "binary.stl": plain_stl.binary(plain_stl.tetrahedron()),
    "text.stl": plain_stl.text(plain_stl.tetrahedron()).encode(),
}


@pytest.mark.parametrize("name", FILES)
def test_compressed_files_expand_into_the_folder(tmp_path, name):
    path = tmp_path / f"{name}.gz"
    path.write_bytes(compress(FILES[name]))
    whole = open_mesh(FILES[name], name)
    seen = []
    mesh = open_streamed(path, None, tmp_path / "folder", lambda *step: seen.append(step))
    assert mesh.n_polygons == whole.n_polygons
    assert mesh.read_vertices(0, 1).tolist() == whole.vertices[:1].tolist()
    assert seen
    seen.clear()
    open_streamed(path, None, tmp_path / "folder", lambda *step: seen.append(step))
    assert not seen
    path.write_bytes(compress(FILES["binary.ply"]) + compress(b"and more"))
    if name == "binary.ply":
        assert open_streamed(path, None, tmp_path / "folder").warnings


@pytest.mark.parametrize("name", ["text.ply", "text.obj", "text.stl", "binary.ply.gz"])
def test_what_needs_a_folder_is_refused_without(tmp_path, name):
    path = tmp_path / name
    data = FILES.get(name) or compress(FILES[name.removesuffix(".gz")])
    path.write_bytes(data)
    with pytest.raises(UnsupportedError) as caught:
        open_streamed(path)
    assert caught.value.hint


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.ply", b""),
        ("a.ply", FILES["text.stl"]),
        ("a.gz", b""),
        ("a.ply.gz", FILES["binary.ply"]),
        ("a.ply.gz", compress(FILES["binary.ply"])[:-9]),
        ("a.ply.gz", compress(FILES["binary.ply"][:-5])),
        ("a.xyz", FILES["binary.ply"]),
        ("a", b"what is it"),
    ],
)
def test_what_is_no_mesh_is_refused_with_the_same_words(tmp_path, name, data):
    from msal_cli.job.opened_mesh import open_mesh as open_whole

    path = tmp_path / name
    path.write_bytes(data)

    def failure(read) -> tuple[str, str, str]:
        with pytest.raises(MsalError) as caught:
            read()
        return caught.value.code, caught.value.where, caught.value.message

    expected = failure(lambda: open_whole(data, name, None))
    found = failure(lambda: open_streamed(path, None, tmp_path / "folder").face_chunks(1))
    assert (found[0], found[1]) == (expected[0], expected[1])
    assert found[2].replace(str(tmp_path) + "/", "") == expected[2]


def test_other_formats_are_refused_with_a_hint(tmp_path):
    path = tmp_path / "a.off"
    path.write_bytes(b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(UnsupportedError) as caught:
        open_streamed(path, folder=tmp_path / "folder")
    assert "OFF" in caught.value.message
    assert caught.value.hint


def test_a_missing_file_is_an_error_of_reading(tmp_path):
    with pytest.raises(InputError) as caught:
        open_streamed(tmp_path / "none.ply")
    assert caught.value.code == "E_READ"


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    path = tmp_path / "text.obj"
    path.write_bytes(FILES["text.obj"])
    (tmp_path / "folder").write_bytes(b"a file")
    with pytest.raises(OutputError):
        open_streamed(path, folder=tmp_path / "folder" / "inside")


def test_a_file_that_became_shorter_is_an_error(tmp_path):
    path = tmp_path / "binary.ply"
    path.write_bytes(FILES["binary.ply"])
    mesh = open_streamed(path)
    path.write_bytes(FILES["binary.ply"][:-40])
    with pytest.raises(InputError) as caught:
        mesh.read_vertices(0, mesh.n_vertices)
    assert caught.value.code == "E_TRUNCATED"
    path.unlink()
    with pytest.raises(InputError) as caught:
        mesh.read_vertices(0, 1)
    assert caught.value.code == "E_READ"
    assert np.float32 is mesh.vertex_type
