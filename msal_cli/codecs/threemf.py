"""3MF: positions replaced inside the XML of its model parts, inside the zip archive.

All else is kept byte for byte: the rest of the XML, every other member of the archive with its
compressed data, times, flags and place.  A mesh that several components or build items show is one
mesh, and is denoised once.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

import numpy as np

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.decimals import (
    SHORTEST,
    SHORTEST_SINGLE,
    SIGNIFICANT_DIGITS,
    extent_decimals,
    print_numbers,
    usual_decimals,
)
from msal_cli.codecs.frames import PLACEMENT
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.slot_file import SlotFile
from msal_cli.codecs.slots import Tokens, require_range, splice
from msal_cli.codecs.threemf_model import Model, parse_model
from msal_cli.codecs.threemf_package import Package
from msal_cli.codecs.zip_archive import Archive
from msal_cli.errors import ContentError, InternalError, MsalError, UnsupportedError
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.buffers import Buffer

_BETWEEN = b"\0"
"""Between the texts of model parts, which have no such byte."""


def read(data: Buffer, name: str) -> ThreeMfFile:
    """Read the meshes of a 3MF file.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError
        if the file is not what its format says, or expands beyond all meshes.
    UnsupportedError
        for encryption, a required extension that is not understood, and rare kinds of archives.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    return ThreeMfFile(data)


class _Coordinates(Tokens):
    """The positions of a mesh.

    A new number has as many decimals as are usual in the mesh, as the old one has, or as 1e-7 of
    the mesh's extent asks for, whichever is most.
    """

    @functools.cached_property
    def _used(self) -> Bytes:
        return self.used_decimals()

    def _decimals(self, values: Floats) -> Bytes:
        """Decimals (3 n,) of new ``values`` (n, 3), those that changed, or ``SHORTEST``."""
        from msal_cli.kernels.digit_writing import MOST_DECIMALS

        needed = extent_decimals(self.values) or 0
        largest = float(np.abs(values[values != self.values]).max(initial=0.0))
        whole = math.ceil(math.log10(largest)) if largest > 1.0 else 0
        most = min(SIGNIFICANT_DIGITS - whole, MOST_DECIMALS)
        if needed > most or most < 0:
            return np.full(values.size, SHORTEST, dtype=np.uint8)
        least = min(max(usual_decimals(self._used), needed), most)
        return np.clip(self._used, least, most).astype(np.uint8)

    def encode(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        return print_numbers(values.reshape(-1)[units], self._decimals(values)[units])

    def rounded(self, values: Floats) -> tuple[Floats, Floats]:
        decimals = self._decimals(values).reshape(values.shape)
        slack = 0.5 * 10.0 ** -decimals.astype(np.float64) * (1.0 + 1e-9)
        return values, np.where(decimals == SHORTEST, 0.0, slack)


class ThreeMfFile(SlotFile):
    """An opened 3MF file; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are those of every mesh, one behind the other.  With several meshes they are in the
    frame of the build, since two may coincide in their own; with one, in its own.

    Its numbers lie in the texts of the model parts, one behind the other.
    """

    def __init__(self, data: Buffer) -> None:
        package = Package(data)
        text = _BETWEEN.join(package.texts.values())
        package.texts.clear()

        def parse(content: Buffer) -> Layout:
            models: Mapping[str, Model] = package.models
            if content is not text:
                texts = [bytes(content)] if len(models) == 1 else bytes(content).split(_BETWEEN)
                models = {n: parse_model(t, n) for n, t in zip(models, texts, strict=True)}
            return _layout(package, models, content)

        super().__init__(text, "3mf", parse)
        self.data = data
        self.package = package

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the coordinates that differ from the stored ones replaced.

        Raises
        ------
        UnsupportedError
            for a file with slices, a beam lattice or a signature, which would no longer fit.
        """
        if np.array_equal(vertices, self.vertices):
            return self.data
        self._require_free()
        return self._pack(super().replaced(vertices))

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3), all of them as the shortest text that is read back as
        the same float32 or float64, unless ``precision`` is ``same``.

        Raises
        ------
        UnsupportedError
            for an encoding other than ``same`` and ``binary``.
        ContentError
            with code ``E_RANGE`` for a position beyond float32.
        """
        if encoding == "ascii":
            raise UnsupportedError("3MF has no ascii encoding", hint="leave --encoding away")
        if precision == "same":
            return self.replaced(vertices)
        self._require_free()
        style = SHORTEST_SINGLE if precision == "float32" else SHORTEST
        edits = []
        for slots, values in zip(self._layout.positions, self._to_file(vertices), strict=True):
            assert isinstance(slots, Tokens)
            if style == SHORTEST_SINGLE:
                require_range(values, np.ones(values.shape, dtype=bool), ("<f4",) * 3)
            text, ends = print_numbers(values.reshape(-1), style)
            edits.append((slots.starts, slots.stops, text, ends))
        return self._pack(splice(as_bytes(self._data), edits))

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        old = self.package.archive
        texts, changed = [], {}
        try:
            new = Archive(output)
            for name in self.package.models:
                before, after = old.find(name), new.find(name)
                assert before is not None
                if after is None:
                    raise InternalError(f"{name} is missing in a 3MF file")
                texts.append(new.content(after, after.size))
                packed = new.packed(after)
                if packed != old.packed(before):
                    changed[name] = packed, after.numbers
            expected = old.assemble(changed)
        except MsalError as failure:
            raise InternalError(f"the 3MF file that was made cannot be read: {failure}") from None
        if expected != output:
            raise InternalError("a 3MF file changed outside its models")
        super().check(_BETWEEN.join(texts), vertices)

    def _pack(self, content: Buffer) -> bytes:
        """The archive with other texts of the model parts, those that changed."""
        if content is self._data:
            return bytes(self.data)
        names = list(self.package.models)
        if len(names) == 1:
            return self.package.archive.replace({names[0]: content})
        pairs = zip(bytes(self._data).split(_BETWEEN), bytes(content).split(_BETWEEN), strict=True)
        return self.package.archive.replace(
            {name: new for name, (old, new) in zip(names, pairs, strict=True) if new != old}
        )

    def _require_free(self) -> None:
        stale = [word for model in self.package.models.values() for word in model.stale]
        if self.package.is_signed:
            stale.append("a digital signature")
        if stale:
            raise UnsupportedError(
                f"the file has {stale[0]}, which would no longer fit a surface that moved",
                hint="export it as a plain mesh, or convert it with --to",
            )

    def _to_file(self, vertices: Floats) -> list[Floats]:
        """New positions of each mesh in its own frame; unmoved ones exactly as they are stored."""
        result = super()._to_file(vertices)
        first = 0
        for values in result:
            is_finite = np.isfinite(values).all(axis=1)
            if not is_finite.all():
                raise ContentError(
                    "a new position is too large for the frame of its mesh",
                    code="E_RANGE",
                    where=f"vertex {first + int(np.argmin(is_finite))}",
                    hint="scale the mesh down",
                )
            first += len(values)
        return result


def _layout(package: Package, models: Mapping[str, Model], text: Buffer) -> Layout:
    data = as_bytes(text)
    positions, faces = [], []
    begin = n_vertices = 0
    for model in models.values():
        for mesh in model.meshes.values():
            if len(mesh.faces):
                # In place, because they take more memory than anything else.
                mesh.starts += begin
                mesh.stops += begin
                starts, stops = mesh.starts.reshape(-1), mesh.stops.reshape(-1)
                positions.append(_Coordinates(data, starts, stops, values=mesh.vertices))
                faces.append(mesh.faces + n_vertices)
                n_vertices += len(mesh.vertices)
        begin += model.size + len(_BETWEEN)
    properties = [f"{len(positions)} parts"] if len(positions) > 1 else []
    unit = next(iter(models.values())).unit
    if unit != "millimeter":
        properties.append(f"unit {unit}")
    if package.has_instances:
        properties.append("instances")
    if package.is_sole_part_placed:
        properties.append(PLACEMENT)
    properties += [word for model in models.values() for word in model.words]
    return Layout(
        "binary",
        "text",
        tuple(positions),
        frames=package.frames,
        properties=tuple(dict.fromkeys(properties)),
        faces=np.concatenate(faces).astype(np.int32),
    )
