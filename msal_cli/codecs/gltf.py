"""glTF as text (.gltf): positions and normals replaced in its buffers.

A buffer is base64 inside the text, which is replaced there, or a file beside it, which is written
beside the output.  Of the other text only the bounds change that the format demands of positions,
and the name of a file that could not be kept.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any
from urllib.parse import quote

from msal_cli.arrays import Floats
from msal_cli.codecs import gltf_buffers
from msal_cli.codecs.gltf_file import SceneFile
from msal_cli.codecs.gltf_json import (
    as_dict,
    as_list,
    find_entries,
    parse_json,
    replace_spans,
    require_short,
)
from msal_cli.codecs.gltf_scene import Scene
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
_DATA_URI = b'"data:'


def read(data: Buffer, name: str) -> GltfFile:
    """Read the surfaces of a .gltf file and of the buffers in its folder; ``name`` is its path.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError
        if the file, or a buffer, is not what its format says.
    InputError
        with code ``E_READ`` if a buffer cannot be read.
    UnsupportedError
        for compressed positions, and buffers outside its folder.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    text = bytes(data)
    # Base64 inside the text does not count.
    size, at = len(text), text.find(_DATA_URI)
    while at >= 0:
        end = max(text.find(b'"', at + 1), at)
        size -= end - at
        at = text.find(_DATA_URI, end + 1)
    require_short(size)
    content = parse_json(text, "description")
    buffers = _Buffers(content, name)
    version = str(as_dict(content.get("asset")).get("version", ""))
    if not version.startswith("2."):
        raise UnsupportedError(
            f"glTF version {version[:20]!r} is not read", hint="convert it to version 2"
        )
    return GltfFile(data, text, buffers, name)


class _Buffers:
    """The buffers of a description, one behind the other.

    Attributes
    ----------
    scene : the scene that they belong to.
    names : the files of those that are files, by their numbers.
    spans : first byte and size of all that each buffer holds, also behind its declared end.
    """

    def __init__(self, content: dict[str, Any], path: str) -> None:
        from msal_cli.kernels.text import as_bytes

        self.names: dict[int, str] = {}
        self.spans: dict[int, tuple[int, int]] = {}
        self._files: dict[str, tuple[int, int]] = {}
        self._contents: list[bytes] = []
        self._size = 0
        self._folder = gltf_buffers.folder_of(path)
        entries = as_list(content.get("buffers"))
        if len(entries) > _MOST_BUFFERS:
            raise TooLargeError(
                f"{len(entries):,} buffers are more than the {_MOST_BUFFERS:,} that are read",
                hint="export the mesh alone",
            )
        places: dict[int, tuple[int, int] | MsalError] = {}
        for number, entry in enumerate(entries):
            # What is wrong with a buffer counts only if a surface is in it.
            try:
                places[number] = self._add(number, as_dict(entry))
            except MsalError as failure:
                places[number] = failure
        contents, self._contents = self._contents, []
        data = contents[0] if len(contents) == 1 else b"".join(contents)
        self.scene = Scene(content, as_bytes(data), places)

    def _add(self, number: int, entry: dict[str, Any]) -> tuple[int, int]:
        """Read a buffer; returns its first byte and its declared size."""
        where = f"buffer {number}"
        uri, declared = entry.get("uri"), entry.get("byteLength")
        if not isinstance(uri, str) or not uri:
            raise FormatError("the buffer names no data", where=where, hint=EXPORT_AGAIN)
        if not isinstance(declared, int) or isinstance(declared, bool) or declared < 0:
            raise FormatError(
                f"byteLength is {declared!r}, not a count", where=where, hint=EXPORT_AGAIN
            )
        content = gltf_buffers.decode_data_uri(uri, where)
        if content is None:
            name = gltf_buffers.file_name(uri, where)
            if name not in self._files:
                self._files[name] = self._append(self._load(name, declared, where))
            span = self._files[name]
            self.names[number] = name
        else:
            span = self._append(content)
        if span[1] < declared:
            raise TruncatedError(
                f"the buffer should have {declared:,} bytes but has {span[1]:,}",
                where=where,
                hint="the file was cut short; copy or export it again",
            )
        self.spans[number] = span
        return span[0], declared

    def _load(self, name: str, declared: int, where: str) -> bytes:
        if self._folder is None:
            raise UnsupportedError(
                f"the buffer {name!r} cannot be read, because the .gltf came without its folder",
                where=where,
                hint="give the file by its path, or export it as .glb",
            )
        room = memory_bytes() // 2 - self._size
        return gltf_buffers.read_buffer(name, self._folder, declared, room, where)

    def _append(self, content: bytes) -> tuple[int, int]:
        span = self._size, len(content)
        self._contents.append(content)
        self._size += len(content)
        return span

    def changed(self, data: Buffer) -> set[int]:
        """The buffers that differ in ``data``, that of the scene with new positions."""
        new, old = memoryview(data), self.scene.data.data
        spans = self.spans.items()
        return {number for number, (at, n) in spans if new[at : at + n] != old[at : at + n]}


class GltfFile(SceneFile):
    """An opened .gltf file."""

    format = "gltf"

    def __init__(self, data: Buffer, text: bytes, buffers: _Buffers, path: str) -> None:
        super().__init__(data, text, buffers.scene)
        self.buffers = buffers
        self._path = path

    def _pack(self, data: memoryview) -> bytes:
        """The text with other data, as far as they are in it; the files that hold the others come
        from ``beside``."""
        text = self.text_of(data).decode("latin-1")
        spans = find_entries(text, "buffers")
        edits = []
        for number in self.buffers.changed(data) - set(self.buffers.names):
            at, size = self.buffers.spans[number]
            uri = self.scene.entry("buffers", number)["uri"]
            new = gltf_buffers.encode_data_uri(uri, data[at : at + size])
            edits.append((spans[number]["uri"], json.dumps(new)))
        return replace_spans(text, edits).encode("latin-1")

    def _unpack(self, output: Buffer, vertices: Floats) -> tuple[bytes, Buffer]:
        """The text with the buffers inside it as they were, and the data; those beside it are not
        written yet."""
        data = self.replace_data(vertices)
        text = bytes(output).decode("latin-1")
        content = parse_json(bytes(output), "description")
        restored = []
        original = find_entries(self.text, "buffers")
        for number, spans in enumerate(find_entries(text, "buffers")):
            if number in self.buffers.names or number not in self.buffers.spans:
                continue
            at, size = self.buffers.spans[number]
            uri = content["buffers"][number]["uri"]
            if gltf_buffers.decode_data_uri(uri, "") != bytes(data[at : at + size]):
                raise InternalError("a buffer of a .gltf file was not written right")
            start, stop = original[number]["uri"]
            restored.append((spans["uri"], self.text[start:stop]))
        return replace_spans(text, restored).encode("latin-1"), data

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The text with ``vertices`` (n, 3); glTF has one encoding and one precision.

        Raises
        ------
        UnsupportedError
            for another encoding or precision, and for a file with others beside it.
        """
        if self.buffers.names:
            raise UnsupportedError(
                "a .gltf with buffers of its own has one encoding",
                hint="leave --encoding and --precision away",
            )
        return super().encoded(vertices, encoding, precision)

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
        if not self.buffers.names:
            return output, ()
        is_moved = bool((vertices != self.vertices).any())
        if path is None or is_url(path):
            if path is None and not is_moved:
                return output, ()
            raise UnsupportedError(
                "a .gltf whose mesh is in a file of its own goes to a folder only", hint=_PACK
            )
        folder, own = Path(path).parent, Path(self._path)
        if is_moved and _is_same(Path(path), own):
            raise UnsupportedError(
                "a .gltf and the file of its mesh cannot be replaced at once",
                hint="write to another folder, or convert it to .glb first",
            )
        data = self.replace_data(vertices) if is_moved else self.scene.data.data
        changed = self.buffers.changed(data)
        names = self._new_names(path, changed)
        companions: dict[str, Companion] = {}
        edits = []
        for number, (at, size) in self.buffers.spans.items():
            if number not in names:
                continue
            name = names[number]
            is_input = _is_same(folder / name, own.parent / self.buffers.names[number])
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
            if name != self.buffers.names[number]:
                edits.append((number, name))
        if edits:
            text = bytes(output).decode("latin-1")
            spans = find_entries(text, "buffers")
            new = [(spans[number]["uri"], json.dumps(quote(name))) for number, name in edits]
            output = replace_spans(text, new).encode("latin-1")
        return output, tuple(companions.values())

    def _new_names(self, path: str, changed: set[int]) -> dict[int, str]:
        """The names of the buffers' files beside an output at ``path``; some buffers changed."""
        stem, new_stem = _stem(self._path), _stem(path)
        names: dict[int, str] = {}
        taken: dict[str, str] = {}
        for number, name in self.buffers.names.items():
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
        content = parse_json(bytes(data), "description")
        for number, entry in enumerate(as_list(content.get("buffers"))):
            uri = as_dict(entry).get("uri")
            if isinstance(uri, str) and uri and not uri.startswith("data:"):
                found.add(gltf_buffers.file_name(uri, f"buffer {number}"))
    except MsalError:
        return set()
    return found
