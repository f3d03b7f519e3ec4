"""Colours of a glTF scene's vertices: COLOR_0 times the base colours of materials."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.colour_values import UNPAINTED, to_bytes
from msal_cli.codecs.gltf_buffers import decode_data_uri
from msal_cli.codecs.gltf_file import SceneFile
from msal_cli.codecs.gltf_json import as_dict, as_list
from msal_cli.codecs.gltf_scene import Part, Scene
from msal_cli.errors import ContentError, MsalError
from msal_cli.view.textures import Texture, decode_texture, read_texture, sample_texture

_TYPES = {5126: ("<f4", 1.0), 5121: ("<u1", 255.0), 5123: ("<u2", 65535.0)}
"""Number types of colours and texture coordinates, and what stands for 1."""

_UINT8 = 5121
_WIDTHS = {"VEC2": 2, "VEC3": 3, "VEC4": 4}


def scene_colours(
    scene_file: SceneFile, folder: Path | None
) -> tuple[NDArray[np.uint8] | None, tuple[str, ...]]:
    """Colours (n, 3) of all vertices, and notes; None where the scene has no colours.

    Images that have files of their own are in ``folder``.
    """
    notes: dict[str, None] = {}
    images = _Images(scene_file.scene, folder, notes)
    parts = [_part_colours(scene_file.scene, part, images) for part in scene_file.parts]
    if all(one is None for one in parts):
        return None, tuple(notes)
    whole = []
    for part, colours in zip(scene_file.parts, parts, strict=True):
        shown = np.tile(np.array(UNPAINTED, dtype=np.uint8), (part.positions.count, 1))
        if colours is not None:
            is_painted = np.isfinite(colours[:, 0])
            shown[is_painted] = to_bytes(_to_srgb(colours[is_painted]), 255.0)
        whole.append(shown)
    return np.concatenate(whole), tuple(notes)


def _part_colours(scene: Scene, part: Part, images: _Images) -> Floats | None:
    """Linear colours (n, 3) of a part, not-a-number where it has none."""
    count = part.positions.count
    colours: Floats | None = None
    for mesh in as_list(scene.content.get("meshes")):
        for primitive in as_list(as_dict(mesh).get("primitives")):
            attributes = as_dict(as_dict(primitive).get("attributes"))
            if attributes.get("POSITION") not in part.accessors:
                continue
            try:
                own = _primitive_colours(scene, primitive, attributes, count, images)
                if own is None:
                    continue
                corners = _corners_of(scene, primitive, count)
            except MsalError as failure:
                images.notes[f"colours cannot be read: {failure}"] = None
                continue
            if colours is None:
                colours = np.full((count, 3), np.nan)
            colours[corners] = own[corners]
    return colours


class _Images:
    """The images of a scene, each decoded once."""

    def __init__(self, scene: Scene, folder: Path | None, notes: dict[str, None]) -> None:
        self.notes = notes
        self._scene, self._folder = scene, folder
        self._known: dict[object, Texture | None] = {}

    def sample(self, named: object, attributes: dict[str, Any], count: int) -> Floats | None:
        """Linear colours (n, 3) of a baseColorTexture at the vertices; None where there is none."""
        if not isinstance(named, dict):
            return None
        key = f"TEXCOORD_{named.get('texCoord', 0)}"
        number = self._scene.entry("textures", named.get("index")).get("source")
        if key not in attributes:
            return None
        if number not in self._known:
            try:
                self._known[number] = self._read(number)
            except MsalError as failure:
                self.notes[str(failure)] = None
                self._known[number] = None
        texture = self._known[number]
        if texture is None:
            return None
        places = _read_numbers(self._scene, attributes[key], ("VEC2",), count)
        shown = sample_texture(texture, places)
        return _to_linear(np.nan_to_num(shown, nan=204.0) / 255.0)

    def _read(self, number: object) -> Texture:
        image = self._scene.entry("images", number)
        uri = image.get("uri")
        if isinstance(uri, str):
            data = decode_data_uri(uri, f"image {number}")
            return (
                read_texture(unquote(uri), self._folder)
                if data is None
                else (decode_texture(data, f"image {number}"))
            )
        return decode_texture(self._scene.read_view(image.get("bufferView")), f"image {number}")


def _corners_of(scene: Scene, primitive: dict[str, Any], count: int) -> Longs | slice:
    """The vertices of a primitive."""
    if "indices" not in primitive:
        return slice(None)
    corners = scene.read_rows(primitive["indices"], {5121: "<u1", 5123: "<u2", 5125: "<u4"}, 1)
    return corners[:, 0].astype(np.int64)


def _primitive_colours(
    scene: Scene,
    primitive: dict[str, Any],
    attributes: dict[str, Any],
    count: int,
    images: _Images,
) -> Floats | None:
    """Linear colours (n, 3) of a primitive for the vertices it names; None where it has none."""
    factor = textured = None
    if "material" in primitive:
        material = scene.entry("materials", primitive["material"])
        surface = as_dict(material.get("pbrMetallicRoughness"))
        if "baseColorFactor" in surface:
            factor = np.array(surface["baseColorFactor"], dtype=np.float64).reshape(4)[:3]
        textured = images.sample(surface.get("baseColorTexture"), attributes, count)
    colours: Floats | None = None
    if "COLOR_0" in attributes:
        index = attributes["COLOR_0"]
        colours = _read_numbers(scene, index, ("VEC3", "VEC4"), count)[:, :3]
        if scene.entry("accessors", index).get("componentType") == _UINT8:
            # The format says linear, but programs for scans write a screen's bytes as they are.
            colours = _to_linear(colours)
    if textured is not None:
        colours = textured if colours is None else colours * textured
    if factor is not None:
        colours = np.tile(factor, (count, 1)) if colours is None else colours * factor
    return colours


def _read_numbers(scene: Scene, index: object, types: tuple[str, ...], count: int) -> Floats:
    """The rows (n, k) of an accessor as floating-point numbers, whole ones as shares of 1."""
    entry = scene.entry("accessors", index)
    kind, number = entry.get("type"), entry.get("componentType")
    if kind not in types or number not in _TYPES or entry.get("count") != count:
        raise ContentError(f"accessor {index!r} does not fit the positions")
    code, one = _TYPES[number]
    rows = scene.read_rows(index, {number: code}, _WIDTHS[kind])
    return rows.astype(np.float64) / one


def _to_linear(shown: Floats) -> Floats:
    """The inverse of ``_to_srgb``."""
    value = np.clip(shown, 0.0, 1.0)
    linear: Floats = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return linear


def _to_srgb(linear: Floats) -> Floats:
    """Linear light as screens take it (IEC 61966-2-1), both from 0 to 1."""
    value = np.clip(linear, 0.0, 1.0)
    curved: Floats = np.where(
        value <= 0.0031308, 12.92 * value, 1.055 * value ** (1.0 / 2.4) - 0.055
    )
    return curved
