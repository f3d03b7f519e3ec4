"""Several files as one mesh in memory."""

from __future__ import annotations

from collections.abc import Mapping

from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError


class JoinedMesh:
    """The vertices (n, 3) and faces (m, 3) of several files behind one another.

    ``properties`` are numbers (n,) of the vertices by name.
    """

    merged_vertices = 0

    def __init__(self, vertices: Floats, faces: Ints, properties: Mapping[str, Floats]) -> None:
        self.vertices, self.faces = vertices, faces
        self._properties = properties

    def forget_vertices(self) -> None:
        """Keep them: they cannot be read again in little time."""

    def vertex_property(self, name: str) -> Floats:
        """A number of each vertex (n,)."""
        if name not in self._properties:
            raise ContentError(f"no file has the vertex property {name!r}", code="E_PROPERTY")
        return self._properties[name]
