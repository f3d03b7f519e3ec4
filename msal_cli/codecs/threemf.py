"""3MF: positions replaced inside the XML of its model parts, inside the zip archive.

All else is kept byte for byte: the rest of the XML, and every other member of the archive with its
compressed data, times, flags and place.  A mesh that several components or build items use is one
mesh, and is denoised once.
"""

import io
import itertools
import math
import zipfile
from collections import deque

import numpy as np

from msal_cli import errors
from msal_cli.arrays import Bytes, Floats, Ints
from msal_cli.codecs import mesh_file, text_slots
from msal_cli.codecs.threemf_model import UNITS, Model, Use, place_of
from msal_cli.codecs.xml_tree import parse_tree
from msal_cli.codecs.zip_archive import Archive, numbers_of
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED
from msal_cli.storage.regular import Buffer, memory_bytes

LARGEST_RATIO = 40  # expanded bytes of XML per byte of the archive; see docs/formats.md

_RELATIONSHIPS = "http://schemas.openxmlformats.org/package/2006/relationships"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_KEYSTORE_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2019/04/keystore"
_ORIGIN_TYPE = (
    "http://schemas.openxmlformats.org/package/2006/relationships/digital-signature/origin"
)
_ROOT = "_rels/.rels"


_SEPARATOR = b"\0"  # separates the texts of model parts, which do not contain this byte


class _Coordinates(text_slots.TextSlots):
    """The positions of a mesh.

    A new number has as many decimals as are usual in the mesh, as the old one has, or as 1e-7 of
    the mesh's extent needs, whichever is most.
    """

    def own_decimals(self, values: Floats) -> Bytes:
        from msal_cli.kernels.numbers import MAX_DECIMALS

        needed = text_slots.extent_decimals(self.values) or 0
        largest = float(np.abs(values[values != self.values]).max(initial=0.0))
        whole = math.ceil(math.log10(largest)) if largest > 1.0 else 0
        most = min(text_slots.SIGNIFICANT_DIGITS - whole, MAX_DECIMALS)
        if needed > most or most < 0:
            return np.full(values.size, text_slots.SHORTEST, dtype=np.uint8)
        least = min(max(text_slots.usual_decimals(self.used), needed), most)
        return np.clip(self.used, least, most).astype(np.uint8)


class ThreeMfFile(mesh_file.MeshFile):
    """An opened 3MF file; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are those of all meshes, concatenated.  With several meshes they are in the frame
    of the build, since two may coincide in their own; with one, in its own.

    Its numbers are in the texts of the model parts, concatenated.
    """

    def __init__(self, data: Buffer) -> None:
        self.archive = Archive(data)
        self.is_signed = False  # whether it has a digital signature of its bytes
        self.models: dict[str, Model] = {}  # model parts by their members' names, the root first
        self._texts: dict[str, bytes] = {}
        self._load(min(memory_bytes() // 2, max(ALWAYS_EXPANDED, LARGEST_RATIO * len(data))))
        placed, has_instances = self._find_frames()
        text = _SEPARATOR.join(self._texts.values())
        self._texts.clear()
        positions, faces, frames = [], [], []
        begin = n_vertices = 0
        for name, model in self.models.items():
            for number, mesh in model.meshes.items():
                if len(mesh.faces):
                    # In place, because they take more memory than anything else.
                    mesh.starts += begin
                    at = mesh.starts.reshape(-1)
                    positions.append(_Coordinates(as_bytes(text), at, values=mesh.vertices))
                    faces.append(mesh.faces + n_vertices)
                    frames.append(placed.get((name, number), np.eye(4)))
                    n_vertices += len(mesh.vertices)
            begin += model.size + len(_SEPARATOR)
        if not faces:
            raise errors.no_faces("the file has no triangles")
        unit = next(iter(self.models.values())).unit
        properties = (
            f"{len(faces)} parts" if len(faces) > 1 else "",
            f"unit {unit}" if unit != "millimeter" else "",
            "instances" if has_instances else "",
            mesh_file.PLACEMENT if len(faces) == 1 and mesh_file.is_placed(frames[0]) else "",
            *(word for model in self.models.values() for word in model.words),
        )
        is_framed = len(faces) > 1 and all(
            mesh_file.is_usable(frame)
            and np.isfinite(mesh_file.transform(slots.values, frame)).all()
            for slots, frame in zip(positions, frames, strict=True)
        )
        layout = mesh_file.Layout(
            "binary",
            "text",
            tuple(positions),
            frames=tuple(frames) if is_framed else (),
            properties=tuple(dict.fromkeys(filter(None, properties))),
            faces=np.concatenate(
                list(map(mesh_file.keep_winding, faces, frames)) if is_framed else faces
            ).astype(np.int32),
        )
        super().__init__(text, "3mf", layout)
        self.data, self.unit = data, UNITS[unit]

    def _member(self, path: str, where: str) -> zipfile.ZipInfo:
        member = self.archive.find(path)
        if member is None:
            raise errors.damaged(f"there is no member {path[:200]!r} in the archive", where)
        return member

    def _root_target(self) -> str:
        root = self._member(_ROOT, "central directory")
        content = self.archive.content(root, 1 << 20)  # real ones have some hundred bytes
        targets = []
        for element in parse_tree(content, name=_ROOT).inner():
            if element.space != _RELATIONSHIPS or element.name != "Relationship":
                continue
            kind = element.attributes.get("Type", "")
            if kind == _KEYSTORE_TYPE:
                raise errors.UnsupportedError(
                    "the file has encrypted content",
                    where=_ROOT,
                    hint="export it without encryption",
                )
            self.is_signed |= kind == _ORIGIN_TYPE
            if kind == _MODEL_TYPE and element.attributes.get("TargetMode") != "External":
                targets.append(element.attributes.get("Target", ""))
        if len(targets) != 1:
            raise errors.damaged(f"the package names {len(targets)} models, not one", _ROOT)
        return targets[0]

    def _load(self, room: int) -> None:
        """Read the root model and all parts that its build and components refer to; they may expand
        to ``room`` bytes in all."""
        waiting = deque([self._member(self._root_target(), _ROOT)])
        while waiting:
            member = waiting.popleft()
            if member.filename in self.models:
                continue
            text = self._texts[member.filename] = self.archive.content(member, room)
            room -= len(text)
            model = self.models[member.filename] = Model(text, member.filename)
            for use in itertools.chain(model.items, *model.components.values()):
                if use.path:
                    other = self.archive.find(use.path)
                    if other is None:
                        raise self._missing(member.filename, use, f"the part {use.path[:200]!r}")
                    waiting.append(other)
        root = next(iter(self.models.values()))
        for name, model in self.models.items():
            if model.unit != root.unit:
                raise errors.UnsupportedError(
                    f"{name} is in {model.unit}, and the root model in {root.unit}",
                    hint="export all parts in one unit",
                )

    def _missing(self, name: str, use: Use, what: str) -> errors.FormatError:
        where = place_of(self._texts[name], name, use.at)
        return errors.damaged(f"{what} is not in the package", where)

    def _find_frames(self) -> tuple[dict[tuple[str, int], Floats], bool]:
        """The frame of each object in the build, by the first path to it, and whether any object
        has several paths.

        An object is followed once, however often it is used, because nested uses can be more than
        any machine can count.
        """
        frames: dict[tuple[str, int], Floats] = {}
        has_instances = False
        root, model = next(iter(self.models.items()))
        waiting = deque((root, use, np.eye(4)) for use in model.items)
        while waiting:
            name, use, above = waiting.popleft()
            member = self.archive.find(use.path) if use.path else None
            own = member.filename if member is not None else name
            model = self.models[own]
            key = own, use.object_id
            if use.object_id not in model.ids:
                raise self._missing(name, use, f"object {use.object_id}")
            if key in frames:
                has_instances = True
                continue
            with np.errstate(all="ignore"):
                frames[key] = above @ use.frame
            parts = model.components.get(use.object_id, ())
            waiting.extend((own, part, frames[key]) for part in parts)
        return frames, has_instances

    def check(self, output: Buffer, vertices: Floats) -> None:
        old = self.archive
        texts, changed = [], {}
        try:
            new = Archive(output)
            for name in self.models:
                before, after = old.find(name), new.find(name)
                assert before is not None
                if after is None:
                    raise errors.InternalError(f"{name} is missing in a 3MF file")
                texts.append(new.content(after, after.file_size))
                packed = new.packed(after)
                if packed != old.packed(before):
                    changed[name] = packed, numbers_of(after)
            expected = old.assemble(changed)
        except errors.MsalError as failure:
            raise errors.InternalError(
                f"the 3MF file that was made cannot be read: {failure}"
            ) from None
        if expected != output:
            raise errors.InternalError("a 3MF file changed outside its models")
        super().check(_SEPARATOR.join(texts), vertices)

    def _pack(self, content: Buffer) -> bytes:
        stale = [word for model in self.models.values() for word in model.stale]
        if self.is_signed:
            stale.append("a digital signature")
        if stale:
            raise errors.UnsupportedError(
                f"the file has {stale[0]}, which would no longer fit a surface that moved",
                hint="export it as a plain mesh, or convert it with --to",
            )
        names = list(self.models)
        if len(names) == 1:
            return self.archive.replace({names[0]: content})
        old_texts, new_texts = bytes(self._data).split(_SEPARATOR), bytes(content).split(_SEPARATOR)
        pairs = zip(old_texts, new_texts, strict=True)
        return self.archive.replace(
            {name: new for name, (old, new) in zip(names, pairs, strict=True) if new != old}
        )

    def _to_file(self, vertices: Floats) -> list[Floats]:
        """New positions of each mesh in its own frame; unmoved ones exactly as stored."""
        result = super()._to_file(vertices)
        is_finite = np.concatenate([np.isfinite(values).all(axis=1) for values in result])
        if not is_finite.all():
            raise errors.ContentError(
                "a new position is too large for the frame of its mesh",
                code="E_RANGE",
                where=f"vertex {int(np.argmin(is_finite))}",
                hint="scale the mesh down",
            )
        return result


_TYPES_PART = b"""<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONSHIP_PART = b"""<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
_HEAD = b"""<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" \
xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
<resources>
<object id="1" type="model">
<mesh>
<vertices>
"""
_MIDDLE = b"</vertices>\n<triangles>\n"
_TAIL = b"""</triangles>
</mesh>
</object>
</resources>
<build>
<item objectid="1"/>
</build>
</model>
"""


def to_3mf(vertices: Floats, faces: Ints, *, single: bool) -> bytes:
    """A 3MF file of vertices (n, 3) and triangles (m, 3); the same bytes on every run.

    Each number is the shortest text that is read as the same float64 (float32 if ``single``).
    """
    from msal_cli.kernels import text

    digits, stops = text.print_shortest(vertices.reshape(-1), single)
    rows = text.fill_rows((b'<vertex x="', b'" y="', b'" z="', b'"/>\n'), digits, stops)
    digits, stops = text.print_numbers(faces.reshape(-1).astype(np.float64), 0)
    triangles = text.fill_rows((b'<triangle v1="', b'" v2="', b'" v3="', b'"/>\n'), digits, stops)
    model = b"".join([_HEAD, rows, _MIDDLE, triangles, _TAIL])
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in (
            ("[Content_Types].xml", _TYPES_PART),
            ("_rels/.rels", _RELATIONSHIP_PART),
            ("3D/3dmodel.model", model),
        ):
            entry = zipfile.ZipInfo(name)  # of 1980
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix
            archive.writestr(entry, content)
    return file.getvalue()
