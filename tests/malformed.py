"""Every malformed file that was made by hand, with the code and the place that it must end in."""

from __future__ import annotations

import gzip

from tests.codecs import test_gltf, test_obj, test_off, test_ply, test_stl, test_threemf, test_vtk
from tests.storage import test_gzip_streams

TRIANGLE = "v {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 2 3\n"
OTHER_FACES = "v 0 0 0\nv 1 0 0\nv 0 1 0\n{}\n"

UNUSABLE = {
    "too far.obj": (TRIANGLE.format("1e61").encode(), "E_RANGE"),
    "too near.obj": (TRIANGLE.format("1e-61").encode(), "E_RANGE"),
    "extent beyond a double.obj": (
        TRIANGLE.format("1e308").replace("v 0", "v -1e308").encode(),
        "E_RANGE",
    ),
    "one point.obj": (TRIANGLE.format("0").encode(), "E_NO_FACES"),
    "repeated corners.obj": (OTHER_FACES.format("f 1 1 2\nf 3 2 3").encode(), "E_NO_FACES"),
    "another format.obj": (b"ply\nformat ascii 1.0\nend_header\n", "E_FORMAT"),
    "another format.stl": (TRIANGLE.format("1").encode(), "E_FORMAT"),
    "another format in gzip.ply.gz": (gzip.compress(b"glTF" + bytes(40), mtime=0), "E_FORMAT"),
    "gzip in gzip.ply.gz": (gzip.compress(gzip.compress(b"ply\n", mtime=0), mtime=0), "E_FORMAT"),
    "empty in gzip.ply.gz": (gzip.compress(b"", mtime=0), "E_TRUNCATED"),
    "no such format.fbx": (b"Kaydara FBX Binary", "E_UNSUPPORTED"),
    "no format": (b"hello world", "E_FORMAT"),
}
"""Files that parse, or that no reader takes: what the way of a file refuses beside its codec."""


def malformed() -> dict[str, tuple[bytes, str, str]]:
    """Content, code and a part of the place by file name; the suffix tells the format."""
    tables = {
        ".ply": test_ply.DAMAGED,
        ".obj": test_obj.DAMAGED,
        ".stl": test_stl.DAMAGED,
        ".glb": test_gltf.DAMAGED_GLB,
        ".gltf": test_gltf.DAMAGED,
        ".3mf": test_threemf.DAMAGED,
        ".ply.gz": test_gzip_streams.DAMAGED,
        "": UNUSABLE | test_off.DAMAGED | test_vtk.DAMAGED | test_vtk.DAMAGED_XML,
    }
    return {
        name + suffix: (*row, "")[:3]
        for suffix, table in tables.items()
        for name, row in table.items()
    }
