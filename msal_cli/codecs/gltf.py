"""glTF as text (.gltf): positions and normals replaced in its buffers.

A buffer is base64 inside the text, which is replaced there, or a file beside it, which is written
beside the output.  Of the other text only the bounds change that the format demands of positions,
and the name of a file that could not be kept.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

from msal_cli.arrays import Floats
from msal_cli.codecs import gltf_buffers
from msal_cli.codecs.gltf_document import MOST_JSON, Document, as_dict, as_list, parsed_description
from msal_cli.codecs.gltf_file import SceneFile
from msal_cli.codecs.gltf_frames import placed
from msal_cli.codecs.gltf_text import edited, entry_spans
from msal_cli.codecs.mesh_file import Companion
from msal_cli.errors import (
    EXPORT_AGAIN,
    FormatError,
    InternalError,
    MsalError,
    OutputError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.gzip_streams import is_gzip_name
from msal_cli.storage.limits import memory_bytes
from msal_cli.storage.urls import is_url

_MOST_BUFFERS = 10_000
_PACK = "write one file with --to glb"


def read(data: Buffer, name: str) -> GltfFile:
    """Read the surfaces of a .gltf file and of the buffers in its folder; ``name`` is its path.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError
        if the file, or a buffer, is not what its format says.
    InputError
        with code ``E_READ`` if a buffer cannot be read.
    UnsupportedError
        for compressed or quantised positions, and buffers outside its folder.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    raw = bytes(data)
    _require_short(raw)
    text, content = parsed_description(raw, "description")
    pieces = _Pieces(content, name)
    document = Document(content, text, 0, pieces.places, pieces.joined(), pieces.failures)
    version = str(as_dict(content.get("asset")).get("version", ""))
    if not version.startswith("2."):
        raise UnsupportedError(
            f"glTF version {version[:20]!r} is not read", hint="convert it to version 2"
        )
    parts, warnings = document.parts()
    frames = placed(document, parts)
    return GltfFile(data, document, parts, frames, warnings, pieces=pieces, path=name)


def _require_short(raw: bytes) -> None:
    """Raise TooLargeError for a long description; base64 inside it does not count."""
    size, at = len(raw), 0
    while size > MOST_JSON and (at := raw.find(b'"data:', at)) >= 0:
        end = raw.find(b'"', at + 1)
        size -= max(end, at) - at
        at = max(end, at + 1)
    if size > MOST_JSON:
        raise TooLargeError(
            f"the description has {size:,} bytes, more than the {MOST_JSON:,} that are read",
            hint="it holds more than a mesh; export the mesh alone",
        )


class _Pieces:
    """The buffers of a description, one behind the other.

    Attributes
    ----------
    places : first byte and declared size of each buffer that could be read.
    failures : why the others could not; that counts only if a surface is in them.
    names : the files of those that are files, by their numbers.
    spans : first byte and size of all that each buffer holds.
    """

    def __init__(self, content: dict[str, object], path: str) -> None:
        self.places: dict[int, tuple[int, int]] = {}
        self.failures: dict[int, MsalError] = {}
        self.names: dict[int, str] = {}
        self.spans: dict[int, tuple[int, int]] = {}
        self._files: dict[str, tuple[int, int]] = {}
        self._contents: list[bytes] = []
        self._size = 0
        self._folder = gltf_buffers.folder_of(path)
        buffers = as_list(content.get("buffers"))
        if len(buffers) > _MOST_BUFFERS:
            raise TooLargeError(
                f"{len(buffers):,} buffers are more than the {_MOST_BUFFERS:,} that are read",
                hint="export the mesh alone",
            )
        for number, entry in enumerate(buffers):
            try:
                self._add(number, as_dict(entry))
            except MsalError as failure:
                self.failures[number] = failure

    def _add(self, number: int, entry: dict[str, object]) -> None:
        where = f"buffer {number}"
        uri, wanted = entry.get("uri"), entry.get("byteLength")
        if not isinstance(uri, str) or not uri:
            raise FormatError("the buffer names no data", where=where, hint=EXPORT_AGAIN)
        if not isinstance(wanted, int) or isinstance(wanted, bool) or wanted < 0:
            raise FormatError(
                f"byteLength is {wanted!r}, not a count", where=where, hint=EXPORT_AGAIN
            )
        content = gltf_buffers.embedded(uri, where)
        if content is None:
            name = gltf_buffers.file_name(uri, where)
            if name not in self._files:
                self._files[name] = self._load(name, wanted, where)
            span = self._files[name]
            self.names[number] = name
        else:
            span = self._append(content)
        if span[1] < wanted:
            raise TruncatedError(
                f"the buffer should have {wanted:,} bytes but has {span[1]:,}",
                where=where,
                hint="the file was cut short; copy or export it again",
            )
        self.spans[number] = span
        self.places[number] = span[0], wanted

    def _load(self, name: str, wanted: int, where: str) -> tuple[int, int]:
        if self._folder is None:
            raise UnsupportedError(
                f"the buffer {name!r} cannot be read, because the .gltf came without its folder",
                where=where,
                hint="give the file by its path, or export it as .glb",
            )
        room = memory_bytes() // 2 - self._size
        return self._append(gltf_buffers.loaded(name, self._folder, wanted, room, where))

    def _append(self, content: bytes) -> tuple[int, int]:
        span = self._size, len(content)
        self._contents.append(content)
        self._size += len(content)
        return span

    def joined(self) -> bytes:
        """All contents; they are not kept here."""
        contents, self._contents = self._contents, []
        return contents[0] if len(contents) == 1 else b"".join(contents)


@dataclass(eq=False)
class GltfFile(SceneFile):
    """An opened .gltf file."""

    pieces: _Pieces = field(kw_only=True, repr=False)
    path: str = field(kw_only=True)
    format: str = "gltf"

    def replaced(self, vertices: Floats) -> Buffer:
        """The text with other positions (n, 3), as far as they are in it; the files that hold the
        others come from ``beside``."""
        if not (vertices != self.vertices).any():
            return self.data
        output = self.patched(vertices)
        edits = self.document.bound_edits(output, [part.positions for part in self.parts])
        spans = entry_spans(self.document.text, "buffers")
        for number, new in self._changed_texts(output).items():
            edits.append((*spans[number]["uri"], new))
        return edited(self.document.text, edits).encode()

    def _changed_texts(self, output: Buffer) -> dict[int, str]:
        """The references, as JSON, of buffers inside the text that changed."""
        found = {}
        for number in self._changed(output):
            if number not in self.pieces.names:
                at, size = self.pieces.spans[number]
                uri = self.document.entry("buffers", number)["uri"]
                content = memoryview(output)[at : at + size]
                found[number] = json.dumps(gltf_buffers.as_embedded(uri, content))
        return found

    def _changed(self, output: Buffer) -> set[int]:
        """The buffers that differ in ``output``, the data with new positions."""
        new, old = memoryview(output), memoryview(self.document.data)
        spans = self.pieces.spans.items()
        return {number for number, (at, n) in spans if new[at : at + n] != old[at : at + n]}

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this text with only ``vertices`` replaced, and
        the files beside it are to be the old ones with only these replaced."""
        data = self.patched(vertices)
        self.check_data(data, 0, vertices)
        try:
            text, content = parsed_description(bytes(output), "description")
        except MsalError as failure:
            raise InternalError(f"the .gltf file that was made cannot be read: {failure}") from None
        restored = []
        original = entry_spans(self.document.text, "buffers")
        for number, spans in enumerate(entry_spans(text, "buffers")):
            if number in self.pieces.names or number not in self.pieces.spans:
                continue
            at, size = self.pieces.spans[number]
            uri = content["buffers"][number]["uri"]
            if gltf_buffers.embedded(uri, "") != bytes(data[at : at + size]):
                raise InternalError("a buffer of a .gltf file was not written right")
            start, stop = original[number]["uri"]
            restored.append((*spans["uri"], self.document.text[start:stop]))
        accessors = [part.positions for part in self.parts]
        self.check_description(edited(text, restored), data, accessors)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The text with ``vertices`` (n, 3); glTF has one encoding and one precision.

        Raises
        ------
        UnsupportedError
            for another encoding or precision, and for a file with others beside it.
        """
        self.require_encoding(encoding, precision)
        if self.pieces.names:
            raise UnsupportedError(
                "a .gltf with buffers of its own has one encoding",
                hint="leave --encoding and --precision away",
            )
        return self.replaced(vertices)

    def beside(
        self, output: Buffer, vertices: Floats, path: str | None
    ) -> tuple[Buffer, tuple[Companion, ...]]:
        """``output``, which ``replaced`` made, and the files that it needs in its folder.

        Where a vertex moved, a buffer that is named as the input is gets the name of the output at
        ``path``, so that two outputs in one folder, or the input, never share one.

        Raises
        ------
        UnsupportedError
            if the output goes to a stream or to an object store, or is the input.
        OutputError
            with code ``E_SIDECAR`` if a buffer of the input would be overwritten.
        """
        if not self.pieces.names:
            return output, ()
        is_moved = bool((vertices != self.vertices).any())
        if path is None or is_url(path):
            if path is None and not is_moved:
                return output, ()
            raise UnsupportedError(
                "a .gltf whose mesh is in a file of its own goes to a folder only", hint=_PACK
            )
        folder, own = Path(path).parent, Path(self.path)
        if is_moved and _is_same(Path(path), own):
            raise UnsupportedError(
                "a .gltf and the file of its mesh cannot be replaced at once",
                hint="write to another folder, or convert it to .glb first",
            )
        data = self.patched(vertices) if is_moved else self.document.data
        changed = self._changed(data)
        names = self._new_names(path, changed)
        companions: dict[str, Companion] = {}
        edits = []
        for number, (at, size) in self.pieces.spans.items():
            if number not in names:
                continue
            name = names[number]
            is_input = _is_same(folder / name, own.parent / self.pieces.names[number])
            if is_input and number not in changed:
                continue
            if is_input:
                raise OutputError(
                    f"the output would replace {name}, which the input names",
                    code="E_SIDECAR",
                    path=os.fspath(folder / name),
                    hint="write to another folder",
                )
            companions[name] = Companion(name, memoryview(data)[at : at + size])
            if name != self.pieces.names[number]:
                edits.append((number, name))
        if edits:
            text = bytes(output).decode()
            spans = entry_spans(text, "buffers")
            new = [(*spans[number]["uri"], json.dumps(quote(name))) for number, name in edits]
            output = edited(text, new).encode()
        return output, tuple(companions.values())

    def _new_names(self, path: str, changed: set[int]) -> dict[int, str]:
        """The names of the buffers' files beside an output at ``path``; some buffers changed."""
        stem, new_stem = _stem(self.path), _stem(path)
        names: dict[int, str] = {}
        taken: dict[str, str] = {}
        for number, name in self.pieces.names.items():
            is_own = Path(name).name == f"{stem}.bin" and stem == new_stem
            if number not in changed or is_own:
                names[number] = name
                continue
            count = f"_{len(taken)}" if taken and name not in taken else ""
            names[number] = taken.setdefault(name, f"{new_stem}{count}.bin")
        return names


def _stem(path: str) -> str:
    """A file's name without ``.gltf`` and ``.gz``."""
    name = Path(path).name
    name = name[:-3] if is_gzip_name(name) else name
    return Path(name).stem


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False


def names_of_buffers(data: Buffer) -> set[str]:
    """The files that the buffers of a .gltf file are in; none if it is no such file."""
    found = set()
    try:
        _, content = parsed_description(bytes(data), "description")
        for number, entry in enumerate(as_list(content.get("buffers"))):
            uri = as_dict(entry).get("uri")
            if isinstance(uri, str) and uri and not uri.startswith("data:"):
                found.add(gltf_buffers.file_name(uri, f"buffer {number}"))
    except MsalError:
        return set()
    return found
