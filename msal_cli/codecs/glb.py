"""Binary glTF (GLB): positions and normals replaced inside its binary chunk.

All else is kept.  Of the JSON only the bounds change that the format demands of positions.
"""

from __future__ import annotations

from dataclasses import dataclass

from msal_cli.arrays import Floats
from msal_cli.codecs.glb_chunks import parsed, with_text
from msal_cli.codecs.gltf_file import SceneFile
from msal_cli.codecs.gltf_frames import placed
from msal_cli.errors import InternalError, MsalError
from msal_cli.storage.buffers import Buffer


def read(data: Buffer, name: str) -> GlbFile:
    """Read the surfaces of a GLB file.

    Raises
    ------
    FormatError, TruncatedError
        if the file is not what its format says.
    UnsupportedError
        for compressed or quantised positions, version 1, and data in other files.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    document = parsed(data)
    parts, warnings = document.parts()
    return GlbFile(data, document, parts, placed(document, parts), warnings)


@dataclass(eq=False)
class GlbFile(SceneFile):
    """An opened GLB file."""

    format: str = "glb"

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with other positions (n, 3), and the normals of what moved recomputed.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        if not (vertices != self.vertices).any():
            return self.data
        output = self.patched(vertices)
        text = self.document.bounded(output, [part.positions for part in self.parts])
        return with_text(self.document, output, text)

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        try:
            there = parsed(output)
        except MsalError as failure:
            raise InternalError(f"the GLB file that was made cannot be read: {failure}") from None
        new = self.check_data(output, there.binary_at - self.document.binary_at, vertices)
        self.check_description(there.text, output, new)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3); GLB has one encoding and one precision.

        Raises
        ------
        UnsupportedError
            for another encoding or precision.
        """
        self.require_encoding(encoding, precision)
        return self.replaced(vertices)
