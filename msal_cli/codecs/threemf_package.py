"""The package around the models of a 3MF file: its parts, what leads to them, and their frames."""

from __future__ import annotations

from collections import deque
from xml.parsers import expat

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.codecs.frames import is_placed, is_usable, transform
from msal_cli.codecs.threemf_model import (
    Model,
    Use,
    parse_model,
    place_of,
    start_parser,
)
from msal_cli.codecs.zip_archive import Archive, Member
from msal_cli.errors import EXPORT_AGAIN, ContentError, FormatError, UnsupportedError
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED
from msal_cli.storage.limits import memory_bytes

LARGEST_RATIO = 40
"""Expanded bytes of XML per byte of the archive; see docs/formats.md."""

_MOST_RELATIONSHIPS = 1 << 20
"""Bytes of the relationships of a package; real ones have some hundred."""

_RELATIONSHIPS = "http://schemas.openxmlformats.org/package/2006/relationships"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_KEYSTORE_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2019/04/keystore"
_ORIGIN_TYPE = (
    "http://schemas.openxmlformats.org/package/2006/relationships/digital-signature/origin"
)
_ROOT = "_rels/.rels"


class Package:
    """A 3MF file taken apart.

    Attributes
    ----------
    archive : the zip archive.
    models : its model parts by the names of their members, the root first.
    texts : the content of these members.
    frames : the frame (4, 4) in the build of each mesh with triangles, in the order of ``models``;
        empty where all of them stay in their own.
    is_signed : whether a digital signature holds its bytes.
    has_instances : whether an object is put to several places.
    is_sole_part_placed : whether there is one mesh only, and the build turns, scales or shifts it.

    Raises
    ------
    FormatError, TruncatedError, UnsupportedError, TooLargeError, ContentError
    """

    def __init__(self, data: Buffer) -> None:
        self.archive = Archive(data)
        self.room = min(memory_bytes() // 2, max(ALWAYS_EXPANDED, LARGEST_RATIO * len(data)))
        self._room = self.room
        self.is_signed = False
        self._root = self._member(self._root_target(), _ROOT)
        self.models: dict[str, Model] = {}
        self.texts: dict[str, bytes] = {}
        self._load()
        placed, self.has_instances = self._find_frames()
        meshes = [
            (mesh, placed.get((name, number), np.eye(4)))
            for name, model in self.models.items()
            for number, mesh in model.meshes.items()
            if len(mesh.faces)
        ]
        if not meshes:
            raise ContentError(
                "the file has no triangles",
                code="E_NO_FACES",
                hint="msal denoises surfaces; this file has none",
            )
        self.is_sole_part_placed = len(meshes) == 1 and is_placed(meshes[0][1])
        is_framed = len(meshes) > 1 and all(
            is_usable(frame) and np.isfinite(transform(mesh.vertices, frame)).all()
            for mesh, frame in meshes
        )
        self.frames = tuple(frame for _, frame in meshes) if is_framed else ()

    def _member(self, path: str, where: str) -> Member:
        member = self.archive.find(path)
        if member is None:
            raise FormatError(
                f"there is no member {path[:200]!r} in the archive", where=where, hint=EXPORT_AGAIN
            )
        return member

    def _content(self, member: Member) -> bytes:
        content = self.archive.content(member, self._room)
        self._room -= len(content)
        return content

    def _root_target(self) -> str:
        """The path of the root model, by the relationships of the package."""
        root = self._member(_ROOT, "central directory")
        content = self.archive.content(root, _MOST_RELATIONSHIPS)
        parser = start_parser(content, _ROOT)
        targets: list[str] = []

        def start(name: str, attributes: dict[str, str]) -> None:
            if name != f"{_RELATIONSHIPS} Relationship":
                return
            kind = attributes.get("Type", "")
            if kind == _KEYSTORE_TYPE:
                raise UnsupportedError(
                    "the file has encrypted content",
                    where=_ROOT,
                    hint="export it without encryption",
                )
            self.is_signed |= kind == _ORIGIN_TYPE
            if kind == _MODEL_TYPE and attributes.get("TargetMode") != "External":
                targets.append(attributes.get("Target", ""))

        parser.StartElementHandler = start
        try:
            parser.Parse(content, True)
        except expat.ExpatError as failure:
            raise FormatError(
                f"the XML is damaged: {expat.ErrorString(failure.code)}",
                where=place_of(content, _ROOT, parser.ErrorByteIndex),
                hint=EXPORT_AGAIN,
            ) from None
        if len(targets) != 1:
            raise FormatError(
                f"the package names {len(targets)} models, not one", where=_ROOT, hint=EXPORT_AGAIN
            )
        return targets[0]

    def _load(self) -> None:
        """Read the root model and all that its build and components lead to."""
        waiting = deque([self._root])
        while waiting:
            member = waiting.popleft()
            if member.name in self.models:
                continue
            text = self.texts[member.name] = self._content(member)
            model = self.models[member.name] = parse_model(text, member.name)
            for use in _uses(model):
                if use.path:
                    other = self.archive.find(use.path)
                    if other is None:
                        raise self._missing(member.name, use, f"the part {use.path[:200]!r}")
                    if other.name not in self.models:
                        waiting.append(other)
        root = self.models[self._root.name]
        for name, model in self.models.items():
            if model.unit != root.unit:
                raise UnsupportedError(
                    f"{name} is in {model.unit}, and the root model in {root.unit}",
                    hint="export all parts in one unit",
                )

    def _missing(self, name: str, use: Use, what: str) -> FormatError:
        where = place_of(self.texts[name], name, use.at)
        return FormatError(f"{what} is not in the package", where=where, hint=EXPORT_AGAIN)

    def _find_frames(self) -> tuple[dict[tuple[str, int], Floats], bool]:
        """The frame of each object that is built, by the first way to it; if one has several.

        An object is followed once, however often it is used, since a file can nest uses so that
        there are more of them than any machine can count.
        """
        known: dict[tuple[str, int], Floats] = {}
        has_instances = False
        waiting = deque(
            (self._root.name, use, np.eye(4)) for use in self.models[self._root.name].items
        )
        while waiting:
            name, use, above = waiting.popleft()
            member = self.archive.find(use.path) if use.path else None
            own = member.name if member is not None else name
            model = self.models[own]
            key = own, use.object_id
            if use.object_id not in model.ids:
                raise self._missing(name, use, f"object {use.object_id}")
            if key in known:
                has_instances = True
                continue
            with np.errstate(all="ignore"):
                known[key] = above @ use.frame
            parts = model.components.get(use.object_id, ())
            waiting.extend((own, part, known[key]) for part in parts)
        return known, has_instances


def _uses(model: Model) -> list[Use]:
    return [*model.items, *(use for uses in model.components.values() for use in uses)]
