"""The page as text: nothing from outside is markup, and the policy allows no more than is there."""

from __future__ import annotations

import base64
import hashlib
from html.parser import HTMLParser

import numpy as np
import pytest

from msal_cli.errors import InternalError
from msal_cli.job.display_names import shown
from msal_cli.mesh import Mesh
from msal_cli.view import scene, viewer
from tests.report.made import HOSTILE_NAMES
from tests.shapes import cube

MESH = Mesh(*cube())
PNG = b"\x89PNG\r\n\x1a\n"


class Parts(HTMLParser):
    """Tags with their attributes, and the text within each kind of element."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.tags, self.texts, self.open = [], {}, []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self.open.append(tag)
        self.texts.setdefault(tag, []).append("")

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        if self.open:
            self.texts[self.open[-1]][-1] += data

    def attributes(self, tag):
        return [found for name, found in self.tags if name == tag]


def page(name="scan.ply", **options):
    return Parts(
        viewer.page_bytes(
            name,
            MESH,
            MESH,
            np.arange(8.0),
            numbers=[(name, [("", name), (name, 9 * name)])],
            notes=[name],
            names=(name, name),
            description=name,
            deviation_name=name,
            picture=PNG,
            **options,
        ).decode("utf-8", "strict")
    )


@pytest.mark.parametrize("name", [*HOSTILE_NAMES, "\udcff.ply", "$title${x}.ply"])
def test_names_stay_text(name):
    plain, hostile = page(), page(name)
    assert [tag for tag, _ in plain.tags] == [tag for tag, _ in hostile.tags]
    assert [sorted(found) for _, found in plain.tags] == [
        sorted(found) for _, found in hostile.tags
    ]
    told = shown(name)
    assert hostile.texts["title"] == hostile.texts["h1"] == [told]
    (box,) = (one for one in hostile.attributes("div") if "data-scene" in one)
    assert box["data-before"] == box["data-after"] == box["data-deviation"] == told
    assert hostile.attributes("img")[0]["alt"] == told
    # A script is the same text whatever the names are.
    assert plain.texts["script"] == hostile.texts["script"]


def test_the_policy_names_what_is_there():
    parts = page()
    policy = next(one for one in parts.attributes("meta") if "http-equiv" in one)["content"]
    rules = dict(one.split(" ", 1) for one in policy.split("; "))
    assert rules["default-src"] == "'none'"
    (style,) = parts.texts["style"]
    data, code = parts.texts["script"]
    for rule, text in (("style-src", style), ("script-src", code)):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[rule] == f"'sha256-{digest}'"
    assert "unsafe" not in policy and "http:" not in policy and "*" not in policy
    assert data == scene.encode_scene(MESH, MESH, np.arange(8.0)).text


def test_a_policy_without_scripts_allows_none():
    assert "script-src 'none'" in viewer.content_policy([], [])


def test_nothing_points_elsewhere():
    for _, attributes in page().tags:
        for key in ("src", "href", "action", "srcset"):
            assert (attributes.get(key) or "data:").startswith("data:")
        assert not any(key.startswith("on") or key == "style" for key in attributes)
    for code in (viewer.script(), viewer.style()):
        for word in ("http", "//cdn", "@import", "fetch(", "innerHTML", "eval(", "url("):
            assert word not in code


def test_a_fragment_for_other_pages():
    drawn = scene.encode_scene(MESH, MESH)
    parts = Parts(viewer.embedded_scene("worst-1", drawn, picture=PNG, before='"<'))
    (box,) = parts.attributes("div")
    assert (box["class"], box["data-scene"], box["data-start"]) == (
        "msal-scene",
        "worst-1",
        "click",
    )
    assert box["data-before"] == '"<'
    (data,) = parts.attributes("script")
    assert data == {"type": "application/octet-stream", "id": "worst-1"}
    assert parts.texts["script"] == [viewer.scene_data(MESH, MESH)] == [drawn.text]
    with pytest.raises(InternalError):
        viewer.embedded_scene('x"><script>', drawn)


def test_what_the_page_holds_is_said():
    few = "".join(page().texts["p"])
    assert "Decimated" not in few and "to within" in few
    many = "".join(page(most_faces=6).texts["p"])
    assert "of 12 faces, the same of both meshes" in many


def test_one_mesh_has_no_split():
    text = viewer.page_bytes("one", MESH).decode()
    assert "Split" not in text.split("<aside")[1].split("</aside>")[0]
