"""Numbers with the decimal comma of some languages, as programs write that follow the system."""

from __future__ import annotations

import pytest

from msal_cli.codecs import open_mesh
from msal_cli.errors import FormatError

HEADER = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(
    f"property float {name}\n" for name in "xyz"
)
TEXTS = {
    "a.ply": HEADER + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1{0}5 0 0\n0 1 0\n3 0 1 2\n",
    "a.obj": "v 0 0 0\nv 1{0}5 0 0\nv 0 1 0\nf 1 2 3\n",
    "a.off": "OFF\n3 1 0\n0 0 0\n1{0}5 0 0\n0 1 0\n3 0 1 2\n",
    "a.stl": "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1{0}5 0 0\n"
    "vertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_decimal_comma_is_named(name):
    assert len(open_mesh(TEXTS[name].format(".").encode(), name).faces) == 1
    for mark, is_named in ((",", True), ("x", False)):
        with pytest.raises(FormatError, match=f"1{mark}5") as caught:
            open_mesh(TEXTS[name].format(mark).encode(), name)
        assert caught.value.hint
        assert ("not a comma" in caught.value.hint) is is_named
