"""Open one mesh file and prepare its mesh: how every command begins, and what its errors become."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from msal_cli import machine
from msal_cli.errors import InternalError, MsalError, ResourceError

if TYPE_CHECKING:
    from msal_cli.codecs.mesh_file import MeshFile, Surface
    from msal_cli.mesh import PreparedMesh
    from msal_cli.storage.buffers import Buffer

log = logging.getLogger("msal")


def open_mesh(data: Buffer, name: str, format: str | None = None) -> tuple[MeshFile, bool]:
    """The mesh file in ``data``, and whether gzip compressed it."""
    from msal_cli import codecs
    from msal_cli.storage import gzip_streams

    plain, is_compressed = gzip_streams.expand(data, name)
    return codecs.open_mesh(plain, name, format), is_compressed


def prepare_mesh(mesh_file: Surface) -> PreparedMesh:
    """The mesh of a file, fit for computing; ContentError if it is not."""
    from msal_cli.mesh import prepare_mesh

    return prepare_mesh(
        mesh_file.vertices, mesh_file.faces, are_distinct=mesh_file.merged_vertices > 0
    )


def to_known_error(error: Exception, name: str) -> MsalError:
    """What a record says of any error; a defect of msal is logged with its traceback."""
    if machine.is_want_of_memory(error):
        return ResourceError(
            error.message if isinstance(error, MsalError) else "not enough memory",
            code="E_MEMORY",
            hint="run fewer jobs at once, or use a machine with more memory",
        )
    if isinstance(error, MsalError):
        return error
    log.exception("internal error at %r", name)
    return InternalError(
        f"{type(error).__name__}: {error}",
        hint="this is a defect of msal; please report it with the file",
    )
