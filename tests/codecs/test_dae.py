"""COLLADA files."""

from __future__ import annotations

import re

import numpy as np
import pytest

from msal_cli.codecs import dae, open_mesh
from msal_cli.errors import MsalError
from tests.codecs.patching import patched
from tests.shapes import noisy, torus

POSITIONS = "0 0 0 1 0 0\n0 1 0 1 1 0"
SOURCE = """<source id="{id}"><float_array id="{id}-array" count="{n}">{values}</float_array>
<technique_common><accessor source="#{id}-array" count="{count}" stride="{stride}">
<param name="X" type="float"/></accessor></technique_common></source>
"""


def source(name: str, values: str, stride: int = 3) -> str:
    n = len(values.split())
    return SOURCE.format(id=name, n=n, values=values, count=n // stride, stride=stride)


def geometry(name: str, surfaces: str, positions: str = POSITIONS, normals: str = "0 0 2") -> str:
    return (
        f'<geometry id="{name}"><mesh>\n'
        + source(f"{name}-p", positions)
        + source(f"{name}-n", normals)
        + source(f"{name}-t", "0 0 1 1", 2)
        + f'<vertices id="{name}-v"><input semantic="POSITION" source="#{name}-p"/></vertices>\n'
        + surfaces.replace("#", f"#{name}-")
        + "</mesh></geometry>\n"
    )


INPUTS = (
    '<input semantic="VERTEX" source="#v" offset="0"/>'
    '<input semantic="NORMAL" source="#n" offset="1"/>'
    '<input semantic="TEXCOORD" source="#t" offset="2" set="0"/>'
)
TRIANGLES = (
    f'<triangles count="2" material="red">{INPUTS}'
    "<p>0 0 0 1 0 1 2 0 0\n1 0 0 3 0 1 2 0 0</p></triangles>"
)


def document(geometries: str, nodes: str = "", more: str = "") -> bytes:
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<COLLADA xmlns="x" version="1.4.1">\n'
        f"<asset><unit name='inch' meter='0.0254'/></asset><!-- caf\xe9 -->\n{more}"
        f"<library_geometries>{geometries}</library_geometries>\n"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene>'
        "</library_visual_scenes></COLLADA>\n"
    ).encode()


def without_numbers(data: bytes) -> bytes:
    """The file without the content of positions and normals."""
    return re.sub(rb'(<float_array id="\w-[pn]-array"[^>]*>)[^<]*', rb"\1", data)


def test_everything_but_positions_and_normals_stays():
    images = (
        "<library_images><image><init_from>wood%20a.png</init_from></image>"
        "<image><init_from>file:///b.png</init_from></image></library_images>"
    )
    data = document(geometry("a", TRIANGLES), more=images)
    file, _, output = patched(data, "a.dae")
    assert file.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert without_numbers(output) == without_numbers(data)
    assert set(file.properties) == {"point.normals", "texture coordinates", "materials"}
    assert file.references == ("wood a.png",)


def test_normals_follow():
    data = document(geometry("a", TRIANGLES))
    file = open_mesh(data, "a.dae")
    turned = file.vertices[:, [2, 0, 1]]
    output = bytes(file.replaced(turned))
    file.check(output, turned)
    assert np.allclose(numbers_of(output, "a-n"), [1, 0, 0], atol=1e-6)


def numbers_of(data: bytes, name: str) -> list[float]:
    found = re.search(rb'<float_array id="%s-array"[^>]*>([^<]*)' % name.encode(), data)
    return [float(one) for one in found[1].split()]


VERTEX = '<input semantic="VERTEX" source="#v" offset="0"/>'


@pytest.mark.parametrize(
    ("surface", "faces"),
    [
        (f"<polylist>{VERTEX}<vcount>4 3</vcount><p>0 1 3 2 0 1 2</p></polylist>", [4, 3]),
        (f"<polygons>{VERTEX}<p>0 1 3 2</p><p>0 1 2</p></polygons>", [4, 3]),
        (f"<tristrips>{VERTEX}<p>0 1 2 3</p></tristrips>", [[0, 1, 2], [2, 1, 3]]),
        (f"<trifans>{VERTEX}<p>0 1 3 2</p></trifans>", [[0, 1, 3], [0, 3, 2]]),
        (f"<lines>{VERTEX}<p>0 1</p></lines><triangles>{VERTEX}<p>0 1 2</p></triangles>", [3]),
    ],
)
def test_kinds_of_surfaces(surface, faces):
    file, _, _ = patched(document(geometry("a", surface)), "a.dae")
    if isinstance(faces[0], list):
        assert file.faces.tolist() == faces
    else:
        assert [len(one) for one in file.polygons()] == faces


def node(name: str, transform: str) -> str:
    return f'<node>{transform}<node><instance_geometry url="#{name}"/></node></node>'


def test_several_meshes_stand_where_the_scene_places_them():
    moves = (
        "<translate>10 0 0</translate><rotate>0 0 2 90</rotate><scale>2 2 2</scale>",
        "<matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</matrix>",
    )
    data = document(
        geometry("a", TRIANGLES) + geometry("b", TRIANGLES) + geometry("c", TRIANGLES),
        node("a", moves[0]) + node("b", moves[1]) + node("b", ""),
    )
    file = open_mesh(data, "a.dae")
    assert np.allclose(file.vertices[1], [10, 2, 0])
    assert np.allclose(file.vertices[2], [8, 0, 0])
    assert np.allclose(file.vertices[4:8, 2], 5)
    assert np.array_equal(file.vertices[8:], file.vertices[4:8] - [0, 0, 5])
    assert file.properties[0] == "3 parts"
    moved = file.vertices.copy()
    moved[2] += [0, 0, 1]
    output = bytes(file.replaced(moved))
    file.check(output, moved)
    # In the own frame of the first, which is half as large; the others did not move.
    assert np.allclose(numbers_of(output, "a-p")[6:9], [0, 1, 0.5])
    assert numbers_of(output, "b-p") == numbers_of(data, "b-p")
    assert numbers_of(output, "b-n") == numbers_of(data, "b-n")
    assert numbers_of(output, "a-n") != numbers_of(data, "a-n")


def test_a_scene_that_names_itself_ends():
    inner = '<instance_node url="#x"/>' * 2
    more = f'<library_nodes><node id="x">{inner}</node></library_nodes>'
    nodes = '<node><instance_node url="#x"/></node>' + node("b", "<translate>1 0 0</translate>")
    data = document(geometry("a", TRIANGLES) + geometry("b", TRIANGLES), nodes, more)
    file = open_mesh(data, "a.dae")
    assert len(file.faces) == 4
    # The nodes behind the circle count.
    assert file.vertices[4:, 0].min() == 1.0


def test_what_is_written_is_read_by_pycollada(tmp_path):
    vertices, faces = torus(12, 8)
    data = dae.written(vertices, faces.astype(np.int32), single=False)
    again = open_mesh(data, "a.dae")
    assert np.array_equal(again.vertices, vertices)
    assert np.array_equal(again.faces, faces)
    moved = noisy(vertices)
    again.check(again.replaced(moved), moved)
    collada = pytest.importorskip("collada")
    path = tmp_path / "a.dae"
    path.write_bytes(data)
    (primitive,) = collada.Collada(str(path)).geometries[0].primitives
    assert np.abs(primitive.vertex - vertices).max() < 1e-6
    assert np.array_equal(primitive.vertex_index, faces)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("1 0 0 3 0 1 2 0 0", "1 0 0 4 0 1 2 0 0", "E_INDEX"),
        ("1 0 0 3 0 1 2 0 0", "1 0 0 3 9 1 2 0 0", "E_INDEX"),
        ("1 0 0 3 0 1 2 0 0", "1 0 0 3 0 1 2 0", "E_FORMAT"),
        ("1 0 0 3 0 1 2 0 0", "1 0 0 3 0 1", "E_FORMAT"),
        ("<p>0", "<p>x", "E_FORMAT"),
        ("0 1 0 1 1 0", "0 1 0 1 1 INF", "E_NONFINITE"),
        ('count="4"', 'count="5"', "E_TRUNCATED"),
        ('count="4"', 'count="999999999"', "E_TRUNCATED"),
        ('stride="3"', 'stride="2"', "E_UNSUPPORTED"),
        ('source="#a-p"', 'source="#q"', "E_FORMAT"),
        ("<triangles", "<lines><p/></lines><spline", "E_FORMAT"),
        ("</p>", "</p><ph/>", "E_UNSUPPORTED"),
        ("<COLLADA", "<COLADA", "E_FORMAT"),
    ],
)
def test_damage(old, new, code):
    text = document(geometry("a", TRIANGLES)).decode()
    assert old in text
    with pytest.raises(MsalError) as caught:
        open_mesh(text.replace(old, new).encode(), "a.dae")
    assert caught.value.code == code


def test_lines_are_no_surface():
    data = document(geometry("a", f"<lines>{VERTEX}<p>0 1</p></lines>"))
    with pytest.raises(MsalError, match="it holds lines"):
        open_mesh(data, "a.dae")


def test_elements_far_beyond_those_of_a_mesh_are_refused(monkeypatch):
    from msal_cli.codecs import xml_offsets as xml_places

    monkeypatch.setattr(xml_places, "MOST_ELEMENTS", 100)
    for data in (b"<COLLADA>" + b"<a/>" * 101 + b"</COLLADA>", b"<a>" * 102):
        with pytest.raises(MsalError) as caught:
            open_mesh(data, "a.dae")
        assert caught.value.code == "E_TOO_LARGE"


def test_deep_elements_are_refused():
    with pytest.raises(MsalError, match="deep in one another"):
        open_mesh(b"<COLLADA>" * 102, "a.dae")


def test_other_encodings_are_refused():
    text = document(geometry("a", TRIANGLES)).decode()
    with pytest.raises(MsalError, match=r"UTF-8|UTF-16"):
        open_mesh(text.replace("utf-8", "utf-16").encode("utf-16"), "a.dae")
    with pytest.raises(MsalError, match="UTF-8"):
        open_mesh(text.replace("utf-8", "klingon").encode(), "a.dae")
