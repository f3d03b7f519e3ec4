"""Files that belong to an output and hold its numbers: the buffers of a .gltf."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Sequence
from pathlib import Path

from msal_cli.codecs.mesh_file import Companion
from msal_cli.errors import MsalError, OutputError
from msal_cli.storage.atomic import Sources, write_whole
from msal_cli.storage.gzip_streams import expand, read_whole
from msal_cli.storage.regular import Buffer


def list_sources(path: str, data: Buffer) -> list[str]:
    """The files that a mesh is read from: that at ``path``, whose bytes are ``data``, and those
    that hold the buffers of a .gltf."""
    if not path.lower().removesuffix(".gz").endswith(".gltf"):
        return [path]
    from msal_cli.codecs.gltf import names_of_buffers

    folder = Path(path).parent
    names = names_of_buffers(expand(data, path)[0])
    return [path, *(os.fspath(folder / name) for name in sorted(names))]


def write_companions(
    companions: Sequence[Companion], output_path: str, sources: Sources = ()
) -> tuple[str, ...]:
    """Write the files that belong to an output, before the output itself.

    A file that is there is replaced only if an output of an earlier run, at ``output_path``, names
    it as its own.  ``sources`` limit the permission bits, see ``storage.atomic.write_whole``.
    Returns what was done, one line for each file.

    Raises
    ------
    OutputError
        with code ``E_SIDECAR`` if another file has the place; ``E_WRITE`` if writing fails.
    """
    folder = Path(output_path).parent
    earlier: set[str] = set()
    if os.path.isfile(output_path):
        from msal_cli.codecs.gltf import names_of_buffers

        with contextlib.suppress(MsalError):
            earlier = names_of_buffers(expand(read_whole(output_path), output_path)[0])
    return tuple(_write(companion, folder, earlier, sources) for companion in companions)


def _write(companion: Companion, folder: Path, earlier: Collection[str], sources: Sources) -> str:
    target = folder / companion.name
    try:
        is_within = Path(os.path.realpath(target)).is_relative_to(os.path.realpath(folder))
        if target.is_file() and is_within and read_whole(target) == companion.data:
            return f"{companion.name} is in place already"
        if os.path.lexists(target) and companion.name not in earlier:
            raise OutputError(
                f"there is another {companion.name} beside the output",
                code="E_SIDECAR",
                path=os.fspath(target),
                hint="move it away, or choose another output folder",
            )
        if not is_within:
            raise OutputError(
                f"{companion.name} would be written outside the output folder",
                path=os.fspath(target),
                hint="choose another output folder",
            )
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as failure:
        raise OutputError(
            f"{companion.name} cannot be written beside the output: {failure.strerror}",
            path=os.fspath(target),
            hint="check the permissions of the output folder",
        ) from failure
    write_whole(target, [companion.data], sources=sources)
    return f"wrote {companion.name}"
