"""glTF: replace positions and normals in binary data, and bounds of positions in the description.

All else is kept: materials, textures, animations, extras, the order of everything.  A GLB file has
its data in a chunk of its own.  A .gltf has them as base64 inside its text, where they are
replaced, or in files beside it, which are written beside the output.  The names of these files are
untrusted: only regular files in the folder of the .gltf are opened."""

import base64
import contextlib
import hashlib
import json
import os
import re
import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path, PureWindowsPath
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from msal_cli import errors
from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.codecs import gltf_scene, mesh_file
from msal_cli.codecs.slots import Change
from msal_cli.codecs.text_slots import replace_spans
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.atomic import Sources, write_whole
from msal_cli.storage.gzip_streams import expand, is_gzip_name, read_whole
from msal_cli.storage.regular import Buffer, memory_bytes, open_regular
from msal_cli.storage.urls import is_url


class SceneFile(mesh_file.MeshFile):
    """An opened scene; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are those of all parts, concatenated.  With several parts they are in the frame of
    the scene, since two parts may coincide in their own; with one part, in its own.

    Its numbers are in ``scene.data``.  Subclasses put that into a file: ``_pack`` makes the file
    with other data and a matching description, and ``_unpack`` gets the description and the data of
    a file that was made for ``vertices`` (n, 3).
    """

    format = ""
    _unpack: Callable[[Buffer, Floats], tuple[bytes, Buffer]]

    def __init__(self, data: Buffer, text: bytes, scene: gltf_scene.Scene) -> None:
        self.scene = scene
        self.text = text.decode("latin-1")
        scene.read_parts()
        super().__init__(scene.data.data, self.format, _layout(scene))
        self.data = data

    def replaced(self, vertices: Floats) -> Buffer:
        if np.array_equal(vertices, self.vertices):
            return self.data
        # Even if all numbers are rounded to the old ones: the bounds may differ.
        return self._pack(self.replaced_data(vertices))

    def check(self, output: Buffer, vertices: Floats) -> None:
        try:
            text, data = self._unpack(output, vertices)
            content = json.loads(text.decode().removeprefix("\ufeff"))
        except (errors.MsalError, ValueError) as failure:
            raise errors.InternalError(
                f"the {self.format} file that was made cannot be read: {failure}"
            ) from None
        super().check(data, vertices)
        expected = json.loads(json.dumps(self.scene.content))
        for index, word, bound in self._bounds(data):
            entry = expected["accessors"][index]
            if word in entry:
                entry[word] = json.loads(gltf_scene.write_bound(json.dumps(entry[word]), bound))
        # Compared as text, because NaN, which Python reads, is not equal to itself.
        is_right = json.dumps(content) == json.dumps(expected)
        if not is_right or text.rstrip(b" ") != self.text_of(data).rstrip(b" "):
            raise errors.InternalError("the description of a scene is not what it should be")

    def _changes(self, vertices: Floats) -> list[Change]:
        # When checking, too, the first part that moved must have positions that can be stored.
        changes = super()._changes(vertices)
        self._require_ranges(changes[:1])
        return changes

    def _bounds(self, data: Buffer) -> Iterator[tuple[int, str, list[float]]]:
        """The bounds of positions in ``data``: accessor, ``min`` or ``max``, numbers."""
        for part in self.scene.parts.values():
            # Column by column, because numpy reduces the first of two axes slowly.
            columns = part.positions.rows(as_bytes(data)).T
            least, most = ([f(column).item() for column in columns] for f in (np.min, np.max))
            for index in part.accessors:
                yield index, "min", least
                yield index, "max", most

    def text_of(self, data: Buffer) -> bytes:
        """The description with the bounds of positions in ``data``."""
        spans = gltf_scene.find_entries(self.text, "accessors")
        edits = [
            (span, gltf_scene.write_bound(self.text[slice(*span)], bound))
            for index, word, bound in self._bounds(data)
            if (span := spans[index].get(word))
        ]
        return replace_spans(self.text, edits).encode("latin-1")


def _layout(scene: gltf_scene.Scene) -> mesh_file.Layout:
    parts, properties, frames = list(scene.parts.values()), scene.properties(), scene.frames()
    if len(parts) > 1:
        properties = (f"{len(parts)} parts", *properties)
    elif mesh_file.is_placed(frames[0]):
        properties = (*properties, mesh_file.PLACEMENT)
    is_framed = len(parts) > 1 and all(map(mesh_file.is_usable, frames))
    positions = tuple(part.positions.slots(scene.data) for part in parts)
    faces, normals = [], []
    first = 0
    for part, slots, frame in zip(parts, positions, frames, strict=True):
        own = np.concatenate(list(part.triangles.values()))
        where = f"accessor {part.positions.index}, vertex {{}}".format
        mesh_file.find_unplaced(slots.values, np.arange(slots.count), where)
        turned = mesh_file.keep_winding(own, frame) if is_framed else own
        faces.append(turned + np.int32(first))
        if part.normals is not None:
            linear = frame[:3, :3] if is_framed else np.eye(3)
            normals.append((own, part.normals.slots(scene.data), linear, first))
        first += slots.count
    return mesh_file.Layout(
        "binary_little_endian",
        "float32" if any(part.positions.code == "<f4" for part in parts) else "integer",
        positions,
        normals=tuple(slots for _, slots, _, _ in normals),
        renew_normals=lambda old, new: [
            _renew_normals(own, slots.values, linear, old[first:], new[first:])
            for own, slots, linear, first in normals
        ],
        frames=tuple(frames) if is_framed else (),
        properties=properties,
        warnings=tuple(scene.notes),
        references=scene.references(),
        faces=np.concatenate(faces),
    )


def _renew_normals(
    faces: Ints, stored: Floats, linear: Floats, old: Floats, new: Floats
) -> tuple[Floats, Flags]:
    """The normals (n, 3) of a part for new vertices, and which of them changed; ``linear`` (3, 3)
    transforms the part into the scene, ``old`` and ``new`` begin with its vertices."""
    from msal_cli.kernels.geometry import regroup_normals

    count = len(stored)
    # A stored normal may be any number.
    with np.errstate(over="ignore", invalid="ignore"):
        normals, is_changed = regroup_normals(
            old[:count], new[:count], faces, faces, stored @ np.linalg.inv(linear)
        )
        normals = normals @ linear
        length = np.sqrt((normals * normals).sum(axis=1, keepdims=True))
        normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.0)
    return normals, is_changed


_HEAD = 20  # bytes before the description: the headers of the file and of its first chunk

_JSON, _BINARY = 0x4E4F534A, 0x004E4942


def expected_bytes(head: memoryview, total: int) -> int:
    """The size that a file should have, by its beginning ``head``; it has ``total`` bytes."""
    if total < _HEAD:
        raise errors.TruncatedError(f"the file has only {total} bytes", hint=errors.EXPORT_AGAIN)
    magic, version, length, size, kind = struct.unpack_from("<4sIIII", head)
    if magic != b"glTF" or (version == 2 and kind != _JSON):
        raise errors.other_format("the file does not begin as a GLB file does", "byte 0", "glb")
    if version != 2:
        raise errors.UnsupportedError(
            f"glTF version {version} is not read", hint="convert it to version 2"
        )
    if length > total or _HEAD + size > length:
        raise errors.cut_short(
            f"the file should have {max(length, _HEAD + size):,} bytes but has {total:,}",
            f"byte {total}",
        )
    gltf_scene.require_short(size, "JSON chunk")
    return int(length)


def _split_glb(data: Buffer) -> tuple[bytes, memoryview, int]:
    """The description, everything after it, and how many bytes of that belong to the file."""
    view = memoryview(data).cast("B")
    length = expected_bytes(view, len(view))
    (size,) = struct.unpack_from("<I", view, 12)
    return bytes(view[_HEAD : _HEAD + size]), view[_HEAD + size :], length - _HEAD - size


def _glb_head(text: bytes, size: int) -> bytes:
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, _HEAD + len(text) + size, len(text), _JSON) + text


class GlbFile(SceneFile):
    format = "glb"

    def __init__(self, data: Buffer) -> None:
        text, rest, length = _split_glb(data)
        content = gltf_scene.parse_json(text, "JSON chunk")
        size = 0
        if length >= 8:
            size, kind = struct.unpack_from("<II", rest)
            size *= kind == _BINARY
            if 8 + size > length:
                raise errors.cut_short(
                    f"the binary chunk should have {size:,} bytes but has {length - 8:,}",
                    f"byte {_HEAD + len(text) + length}",
                )
        is_inside = "uri" not in (gltf_scene.as_dicts(content.get("buffers")) or [{}])[0]
        places = {0: (8 * (size > 0), size)} if is_inside else {}
        super().__init__(data, text, gltf_scene.Scene(content, as_bytes(rest), places))

    def _pack(self, data: Buffer) -> bytes:
        """The file with other data after the description, whose padding is adjusted."""
        head = bytes(memoryview(self.data).cast("B")[: _HEAD + len(self.text)])
        text = self.text_of(data)
        if text != head[_HEAD:]:
            padding = len(text) - len(text.rstrip(b" "))
            head = _glb_head(text[: len(text) - min(padding, 3)], len(data))
        return b"".join([head, data])

    def _unpack(self, output: Buffer, vertices: Floats) -> tuple[bytes, Buffer]:
        text, data, length = _split_glb(output)
        head, own_head = (bytes(memoryview(file).cast("B")[:_HEAD]) for file in (output, self.data))
        if length != len(data) and head != own_head:
            raise errors.InternalError("the length in its header is not what it should be")
        return text, data


_BASE64 = ";base64,"
_DATA_URI = re.compile(rb'"data:[^"]*"')
_MAX_BEHIND = 256 << 20  # bytes after the declared end of a buffer that are kept, whatever its size

_MAX_BUFFERS = 10_000
_AS_GLB = "export it as .glb, which holds everything in one file"


def _decode_data_uri(uri: str, where: str) -> bytes | None:
    """The content of a ``data:`` reference; None for any other."""
    if uri[:5].lower() != "data:":
        return None
    comma = uri.find(",", 0, 1000)
    if not uri[: comma + 1].lower().endswith(_BASE64):
        raise errors.UnsupportedError(
            "data that are not base64 are not read", where=where, hint=_AS_GLB
        )
    try:
        return base64.b64decode(uri[comma + 1 :], validate=True)
    except ValueError as failure:
        raise errors.damaged(f"the data are not base64: {str(failure)[:100]}", where) from None


def _file_name(uri: str, where: str) -> str:
    """The path, with slashes, of a reference relative to the folder of its .gltf.

    Raises UnsupportedError if it leads out of that folder, or is not a path.
    """
    try:
        name = unquote(uri, errors="strict")
    except UnicodeDecodeError:  # percent signs that are no escapes
        name = uri
    if (
        gltf_scene.has_scheme(uri)
        or not name.strip()
        or name.startswith("/")
        or "\0" in name
        or ".." in name.split("/")
        or PureWindowsPath(name).drive
        or "\\" in name
    ):
        raise errors.UnsupportedError(
            f"the buffer {uri[:200]!r} is not in the folder of the .gltf, and is not read",
            where=where,
            hint=f"put it beside the .gltf, or {_AS_GLB}",
        )
    return name


def _read_file(name: str, path: str, declared: int, room: int, where: str) -> bytes:
    """The file ``name`` beside ``path``: ``declared`` bytes are expected, ``room`` allowed."""
    # Streams and objects in a store have no folder.
    if path in ("", "-") or is_url(path):
        raise errors.UnsupportedError(
            f"the buffer {name!r} cannot be read, because the .gltf came without its folder",
            where=where,
            hint="give the file by its path, or export it as .glb",
        )
    folder = os.path.realpath(Path(path).parent)
    try:
        target = os.path.realpath(Path(path).parent / name)
        if not Path(target).is_relative_to(folder):
            raise errors.UnsupportedError(
                f"the buffer {name!r} is a link that leads out of the folder, and is not read",
                where=where,
                hint="put the file itself beside the .gltf",
            )
        with open_regular(target) as file:
            size = os.fstat(file.fileno()).st_size
            if size > min(2 * declared + _MAX_BEHIND, room):
                raise errors.TooLargeError(
                    f"the buffer {name!r} has {size:,} bytes, not {declared:,}",
                    where=where,
                    hint="export the mesh again",
                )
            return file.read()
    except (OSError, ValueError) as failure:
        reason = getattr(failure, "strerror", None) or str(failure)
        raise errors.InputError(
            f"the buffer {name!r} beside the .gltf cannot be read: {reason}",
            where=where,
            code="E_READ",
            hint="copy it beside the .gltf; a .gltf does not hold its mesh itself",
        ) from failure


class GltfFile(SceneFile):
    format = "gltf"

    def __init__(self, data: Buffer, path: str) -> None:
        text = bytes(data)
        # Base64 inside the text is not counted.
        uris = (uri.end() - uri.start() for uri in _DATA_URI.finditer(text))
        gltf_scene.require_short(len(text) - sum(size - 1 for size in uris))
        content = gltf_scene.parse_json(text, "description")
        self._path = path
        self.names: dict[int, str] = {}  # for buffers that are files, their names by number
        # For each buffer, its first byte and size in the data, with bytes after its declared end.
        self.spans: dict[int, tuple[int, int]] = {}
        entries = gltf_scene.as_dicts(content.get("buffers"))
        if len(entries) > _MAX_BUFFERS:
            raise errors.TooLargeError(
                f"{len(entries):,} buffers are more than the {_MAX_BUFFERS:,} that are read",
                hint="export the mesh alone",
            )
        places: dict[int, tuple[int, int] | errors.MsalError] = {}
        pieces: list[bytes] = []
        files: dict[str, tuple[int, int]] = {}
        size = 0
        for number, entry in enumerate(entries):
            # An invalid buffer is an error only if a surface uses it.
            try:
                piece = self._read_buffer(number, entry, size, files)
                pieces.append(piece)
                size += len(piece)
                places[number] = self.spans[number][0], entry["byteLength"]
            except errors.MsalError as failure:
                places[number] = failure.with_traceback(None)
        version = str(gltf_scene.as_dict(content.get("asset")).get("version", ""))
        if not version.startswith("2."):
            raise errors.UnsupportedError(
                f"glTF version {version[:20]!r} is not read", hint="convert it to version 2"
            )
        super().__init__(data, text, gltf_scene.Scene(content, as_bytes(b"".join(pieces)), places))
        self.sources = tuple(os.fspath(Path(path).parent / name) for name in sorted(files))

    def _read_buffer(
        self, number: int, entry: dict[str, Any], start: int, files: dict[str, tuple[int, int]]
    ) -> bytes:
        """The bytes of a buffer, which get the place ``start`` in the data; empty if it shares one
        of the ``files`` that were read before."""
        where = f"buffer {number}"
        uri, declared = entry.get("uri"), entry.get("byteLength")
        if not isinstance(uri, str) or not uri:
            raise errors.damaged("the buffer names no data", where)
        if not isinstance(declared, int) or isinstance(declared, bool) or declared < 0:
            raise errors.damaged(f"byteLength is {declared!r}, not a count", where)
        content = _decode_data_uri(uri, where)
        if content is None:
            name = _file_name(uri, where)
            if name not in files:
                room = memory_bytes() // 2 - start
                content = _read_file(name, self._path, declared, room, where)
                files[name] = start, len(content)
            self.names[number], span = name, files[name]
        else:
            span = start, len(content)
        if span[1] < declared:
            raise errors.cut_short(
                f"the buffer {uri[:40]!r} should have {declared:,} bytes but has {span[1]:,}", where
            )
        self.spans[number] = span
        return content or b""

    def _changed_buffers(self, data: Buffer) -> set[int]:
        """The buffers that differ in ``data``, the data of the scene with new positions."""
        new, old = memoryview(data), self.scene.data.data
        spans = self.spans.items()
        return {number for number, (at, n) in spans if new[at : at + n] != old[at : at + n]}

    def _pack(self, data: Buffer) -> Buffer:
        """The text with other data, if they are inside it; files for the other buffers are made by
        ``beside``."""
        uris = {}
        for number in self._changed_buffers(data) - set(self.names):
            at, size = self.spans[number]
            uri = self.scene.entry("buffers", number)["uri"]
            uris[number] = (
                uri[: uri.index(",") + 1] + base64.b64encode(data[at : at + size]).decode()
            )
        return _replace_uris(self.text_of(data), uris)

    def _unpack(self, output: Buffer, vertices: Floats) -> tuple[bytes, Buffer]:
        """The text with its inner buffers as they were, and the data; buffers in files are not
        written yet."""
        data = self.replaced_data(vertices)
        text = bytes(output).decode("latin-1")
        content = gltf_scene.parse_json(bytes(output), "description")
        restored = []
        original = gltf_scene.find_entries(self.text, "buffers")
        for number, spans in enumerate(gltf_scene.find_entries(text, "buffers")):
            if number in self.names or number not in self.spans:
                continue
            at, size = self.spans[number]
            uri = content["buffers"][number]["uri"]
            if _decode_data_uri(uri, "") != bytes(data[at : at + size]):
                raise errors.InternalError("a buffer of a .gltf file was not written right")
            restored.append((spans["uri"], self.text[slice(*original[number]["uri"])]))
        return replace_spans(text, restored).encode("latin-1"), data

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        if self.names:
            raise errors.UnsupportedError(
                "a .gltf with buffers of its own has one encoding",
                hint="leave --encoding and --precision away",
            )
        return super().encoded(vertices, encoding, precision)

    def beside(
        self, output: Buffer, vertices: Floats, path: str | None
    ) -> tuple[Buffer, tuple[mesh_file.Companion, ...]]:
        """``output``, which ``replaced`` made, and the files that it needs in its folder.

        If a vertex moved, a buffer that is named after the input is renamed after the output at
        ``path``, so that two outputs in one folder, or an output and the input, never share one.

        Raises UnsupportedError if the output goes to a stream or to an object store, or is the
        input; OutputError (``E_SIDECAR``) if a buffer of the input would be overwritten.
        """
        is_moved = bool((vertices != self.vertices).any())
        if not self.names or (path is None and not is_moved):
            return output, ()
        if path is None or is_url(path):
            raise errors.UnsupportedError(
                "a .gltf whose mesh is in a file of its own goes to a folder only",
                hint="write one file with --to glb",
            )
        folder, own = Path(path).parent, Path(self._path)
        if is_moved and _is_same(Path(path), own):
            raise errors.UnsupportedError(
                "a .gltf and the file of its mesh cannot be replaced at once",
                hint="write to another folder, or convert it to .glb first",
            )
        data = self.replaced_data(vertices) if is_moved else self.scene.data.data
        changed = self._changed_buffers(data)
        companions: dict[str, mesh_file.Companion] = {}
        uris = {}
        stem, new_stem = _stem(self._path), _stem(path)
        renamed: dict[str, str] = {}
        for number, old_name in self.names.items():
            name = old_name
            is_own = Path(name).name == f"{stem}.bin" and stem == new_stem
            if number in changed and not is_own:
                count = f"_{len(renamed)}" if renamed else ""
                name = renamed.setdefault(name, f"{new_stem}{count}.bin")
            is_input = _is_same(folder / name, own.parent / old_name)
            if number not in self.spans or (is_input and number not in changed):
                continue
            if is_input:
                raise errors.OutputError(
                    f"the output would replace {name}, which the input names",
                    code="E_SIDECAR",
                    path=os.fspath(folder / name),
                    hint="write to another folder",
                )
            at, size = self.spans[number]
            companions[name] = mesh_file.Companion(name, memoryview(data)[at : at + size])
            if name != old_name:
                uris[number] = quote(name)
        return _replace_uris(output, uris), tuple(companions.values())


def _replace_uris(text: Buffer, uris: dict[int, str]) -> Buffer:
    if not uris:
        return text
    plain = bytes(text).decode("latin-1")
    spans = gltf_scene.find_entries(plain, "buffers")
    edits = [(spans[number]["uri"], json.dumps(uri)) for number, uri in uris.items()]
    return replace_spans(plain, edits).encode("latin-1")


def _stem(path: str) -> str:
    name = Path(path).name
    return Path(name[:-3] if is_gzip_name(name) else name).stem


def _is_same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except OSError:
        return False


def names_of_buffers(data: Buffer) -> set[str]:
    """The files of the buffers of a .gltf file; empty if it is not one."""
    try:
        uris = [
            entry.get("uri")
            for entry in gltf_scene.as_dicts(gltf_scene.parse_json(bytes(data), "").get("buffers"))
        ]
        paths = [uri for uri in uris if isinstance(uri, str) and uri]
        return {_file_name(uri, "") for uri in paths if not uri.startswith("data:")}
    except errors.MsalError:
        return set()


def write_companions(
    companions: Sequence[mesh_file.Companion], output_path: str, sources: Sources = ()
) -> tuple[str, ...]:
    """Write the files that belong to an output, before the output itself.

    An existing file is replaced only if an earlier output at ``output_path`` refers to it.
    ``sources`` limit the permission bits, see ``storage.atomic.write_whole``.
    Returns what was done, one line for each file.

    Raises OutputError: ``E_SIDECAR`` if another file has the name, else ``E_WRITE``.
    """
    folder = Path(output_path).parent
    earlier: set[str] = set()
    if os.path.isfile(output_path):
        with contextlib.suppress(errors.MsalError):
            earlier = names_of_buffers(expand(read_whole(output_path), output_path))
    return tuple(_write_companion(companion, folder, earlier, sources) for companion in companions)


def _write_companion(
    companion: mesh_file.Companion, folder: Path, earlier: Collection[str], sources: Sources
) -> str:
    target = folder / companion.name
    named = f"{companion.name} (SHA-256 {hashlib.sha256(companion.data).hexdigest()})"
    try:
        is_within = Path(os.path.realpath(target)).is_relative_to(os.path.realpath(folder))
        if target.is_file() and is_within and read_whole(target) == companion.data:
            return f"{named} is in place already"
        if os.path.lexists(target) and companion.name not in earlier:
            raise errors.OutputError(
                f"there is another {companion.name} beside the output",
                code="E_SIDECAR",
                path=os.fspath(target),
                hint="move it away, or choose another output folder",
            )
        if not is_within:
            raise errors.OutputError(
                f"{companion.name} would be written outside the output folder",
                path=os.fspath(target),
                hint="choose another output folder",
            )
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as failure:
        raise errors.OutputError(
            f"{companion.name} cannot be written beside the output: {failure.strerror}",
            path=os.fspath(target),
            hint="check the permissions of the output folder",
        ) from failure
    write_whole(target, [companion.data], sources=sources)
    return f"wrote {named}"


def repack(file: SceneFile, vertices: Floats, to: str) -> bytes | None:
    """The scene with ``vertices`` (n, 3) as ``glb`` or ``gltf``.

    None if that would lose something: buffers that could not be read, or views that an extension
    describes a second time.
    """
    is_moved = bool((vertices != file.vertices).any())
    data = memoryview(file.replaced_data(vertices))
    text = file.text_of(data) if is_moved else file.text.encode("latin-1")
    content = json.loads(text.decode().removeprefix("\ufeff"))
    try:
        binary = _merge_buffers(content, file.scene.buffers, data)
    except (TypeError, ValueError, LookupError, AttributeError):
        return None
    if to == "gltf":
        uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
        content["buffers"][0]["uri"] = uri
        return _to_json(content)
    binary += bytes(-len(binary) % 4)
    chunk = struct.pack("<II", len(binary), _BINARY) + binary
    return _glb_head(_to_json(content), len(chunk)) + chunk


def _merge_buffers(content: dict[str, Any], places: Mapping[int, Any], data: memoryview) -> bytes:
    """All buffers concatenated; the description is changed to match.

    Raises ValueError and others if that is impossible.
    """
    starts: list[int] = []
    pieces: list[Buffer] = []
    size = 0
    for number in range(len(content["buffers"])):
        at, length = places[number]
        pieces += [bytes(-size % 4), data[at : at + length]]
        starts.append(size + -size % 4)
        size = starts[-1] + length
    for entry in content["bufferViews"]:
        if "extensions" in entry:
            raise ValueError("an extension may name the buffer again")
        entry["byteOffset"] = entry.get("byteOffset", 0) + starts[entry["buffer"]]
        entry["buffer"] = 0
    first = content["buffers"][0] if len(starts) == 1 else {}
    first.pop("uri", None)
    content["buffers"] = [first | {"byteLength": size}]
    return b"".join(pieces)


def _to_json(content: dict[str, Any]) -> bytes:
    """The description as UTF-8; lone surrogates, which UTF-8 lacks, stay escaped."""
    try:
        return json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return json.dumps(content, separators=(",", ":")).encode()
