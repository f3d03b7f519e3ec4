"""Materials and textures: files that the input refers to must also be found from the output.

A file is copied to the same relative place; nothing is overwritten by default.  Several workers may
copy the same file at once, because meshes in one folder share their materials.
"""

import filecmp
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath

from msal_cli.errors import OutputError
from msal_cli.storage.atomic import write_new, write_whole
from msal_cli.storage.regular import open_regular
from msal_cli.storage.urls import is_url

MAX_MATERIAL_BYTES = 16 << 20
"""Bytes of a material library that are searched for textures; real ones have a few thousand."""

MAX_REFERENCES = 10_000
"""Files that one mesh may refer to."""

MAX_BYTES = 4 << 30
"""Bytes of all files that are copied for one mesh; a sparse file can have any size."""

_IN_PLACE = " is in place already"
_NOTE = re.compile(
    rf"(?s)(?:copied |wrote |(?=.*{_IN_PLACE}\Z))(.*?)(?: \(SHA-256 (\w{{64}})\))?(?:{_IN_PLACE})?"
)
_PIECE = 8 << 20
_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_OPTION = (
    rb"-(?:(?:blend[uv]|cc|clamp|boost|texres|bm|imfchan|type|colorspace)\s+\S+|mm\s+\S+\s+\S+"
    rb"|[ost](?:\s+" + _NUMBER + rb"(?!\S)){1,3})(?:\s+|$)"
)
_TEXTURE = re.compile(
    rb"\s*(?:map_\S*|bump|disp|decal|refl|norm)\s+(?>(?:" + _OPTION + rb")*)(.*)", re.IGNORECASE
)
"""A line that names a texture: a keyword, options with a fixed number of words or up to three
numbers, and the name, which may contain blanks and begin with a hyphen."""


def carry(
    references: Sequence[str],
    input_path: str | os.PathLike[str],
    output_path: str | os.PathLike[str],
    *,
    force: bool = False,
    depth: int = 0,
) -> tuple[str, ...]:
    """Copy the files that an input refers to, so that they are found from the output's folder.

    Each gets the same place relative to the output as it has relative to the input, byte for byte;
    textures that a copied ``.mtl`` names are copied, too.  A file that is there already with the
    same content is left alone.  An absolute reference needs nothing.  One whose file is missing or
    not regular, and one that leads out of the folder of the input or of the output, also by a link,
    are only reported: a scan from elsewhere must not copy files of this machine along.  To and from
    URLs nothing is copied.

    Parameters
    ----------
    references : the names, as written in the input.
    input_path, output_path : the mesh files; the output's folder is made if it is missing.
    force : replace other files that are not newer than the existing output: they may be its old
        copies, and belong to no other input of this run.
    depth : number of folders from the mesh's up to the searched one; references may lead there.

    Returns what was done, one line for each file; lines that need attention begin with
    ``warning:``.  Raises OutputError: ``E_SIDECAR`` if another file has the name, ``E_WRITE`` if
    copying fails.
    """
    if any(isinstance(path, str) and is_url(path) for path in (input_path, output_path)):
        # A later run could not see which run owns a name.
        names = [name for name in dict.fromkeys(references) if not _is_absolute(name)]
        more = f" and {len(names) - 3:,} more" if len(names) > 3 else ""
        said = f"{', '.join(names[:3])}{more}"
        return (f"warning: not copied to or from an object store: {said}",) if names else ()
    folders = Path(input_path).parent, Path(output_path).parent
    roots = [(folder, *folder.parents)[depth] for folder in folders]
    notes: list[str] = []
    done: set[str] = set()
    made_at = os.lstat(output_path).st_mtime_ns if force and os.path.lexists(output_path) else -1
    # Bytes that may still be copied.
    budget = [MAX_BYTES]
    waiting = list(references)
    while waiting:
        reference = waiting.pop(0)
        if reference in done:
            continue
        if len(done) == MAX_REFERENCES:
            notes.append(f"warning: only the first {MAX_REFERENCES} references are followed")
            break
        done.add(reference)
        relative = _relative(reference, folders[0])
        notes.append(_carry(reference, relative, folders, roots, budget, made_at))
        if not reference.lower().endswith(".mtl") or relative is None:
            continue
        library = folders[0] / relative
        if _is_within(library, roots[0]):
            # A name in a library is relative to the library.
            folder = reference.replace("\\", "/").rpartition("/")[0]
            place = "" if folder in ("", ".") else f"{folder}/"
            waiting += [name if _is_absolute(name) else place + name for name in _textures(library)]
    return tuple(note for note in notes if note)


def list_carried(notes: Sequence[str], input_path: str, output_path: str) -> list[tuple[str, str]]:
    """The files beside an output that ``notes``, the ``sidecars`` of its record, name, and their
    SHA-256, empty where it is not known."""
    folder, found = Path(output_path).parent, filter(None, map(_NOTE.fullmatch, notes))
    named = (match.groups("") for match in found)
    places = ((_relative(name, Path(input_path).parent), sha256) for name, sha256 in named)
    return [(str(folder / place), sha256) for place, sha256 in places if place]


def _is_absolute(reference: str) -> bool:
    return (
        PurePosixPath(reference).is_absolute()
        or PureWindowsPath(reference).is_absolute()
        or bool(PureWindowsPath(reference).drive)
    )


def _relative(reference: str, folder: Path) -> Path | None:
    """A reference as a path from ``folder``; backslashes separate parts only if they must."""
    if not reference.strip() or "\0" in reference or _is_absolute(reference):
        return None
    literal = Path(reference)
    if "\\" in reference and not os.path.isfile(folder / literal):
        return Path(*PureWindowsPath(reference).parts)
    return literal


def _carry(
    reference: str,
    relative: Path | None,
    folders: Sequence[Path],
    roots: Sequence[Path],
    budget: list[int],
    made_at: int,
) -> str:
    """Copy one file, also over one that is not newer than ``made_at``; returns what was done, empty
    if nothing had to be."""
    if relative is None:
        if _is_absolute(reference):
            return f"{reference} is an absolute path and stays as it is"
        return "warning: a reference without a usable name is left alone"
    source, target = (folder / relative for folder in folders)
    if not os.path.isfile(source):
        if source.exists():
            return f"warning: {reference} is not a regular file and is not copied"
        return f"warning: {reference} is missing beside the input"
    if not os.access(source, os.R_OK):
        return f"warning: {reference} may not be read"
    try:
        if target.exists() and target.samefile(source):
            return ""
        size = source.stat().st_size
        if size > budget[0]:
            return (
                f"warning: {reference} is not copied: more than {MAX_BYTES:,} bytes belong to "
                "one mesh"
            )
        budget[0] -= size
        if target.exists() and _is_same(source, target):
            return f"{reference}{_IN_PLACE}"
        is_old = target.exists() and target.stat().st_mtime_ns <= made_at
    except OSError as failure:
        return f"warning: {reference} cannot be compared: {failure.strerror}"
    for path, root, what in zip((source, target.parent), roots, ("input", "output"), strict=True):
        if not _is_within(path, root):
            return f"warning: {reference} leads out of the {what} folder and is not copied"
    _copy(source, target, write_whole if is_old else write_new)
    return f"copied {reference}"


def _is_same(source: Path, target: Path) -> bool:
    return target.is_file() and filecmp.cmp(source, target, shallow=False)


def _is_within(path: Path, folder: Path) -> bool:
    """Whether ``path`` lies in ``folder`` once ``..`` and links are followed."""
    try:
        place = Path(os.path.realpath(path))
        return place.is_relative_to(os.path.realpath(folder))
    except (OSError, ValueError):
        return False


def _copy(source: Path, target: Path, write: Callable[..., object]) -> None:
    """Copy a file with ``write``; if that finds the name taken, the contents must be equal."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with open_regular(source) as stream:
            pieces = iter(lambda: stream.read(_PIECE), b"")
            is_taken = write(target, pieces, sources=[source]) is False
        if is_taken and not _is_same(source, target):
            raise OutputError(
                f"there is another {target.name} beside the output than {source}, which the input "
                "names",
                code="E_SIDECAR",
                path=os.fspath(target),
                hint="delete it or give --force if it is an old copy; write meshes with different "
                "materials to separate output folders",
            )
    except OSError as failure:
        raise OutputError(
            f"{source.name} cannot be copied beside the output: {failure.strerror}",
            path=os.fspath(target),
            hint="check the permissions of the output folder, and of the file",
        ) from failure


def _textures(library: Path) -> list[str]:
    try:
        with open_regular(library) as stream:
            text = stream.read(MAX_MATERIAL_BYTES)
    except OSError:
        return []
    found = map(_TEXTURE.match, re.sub(rb"\\\r?\n", b" ", text).splitlines())
    names = (match[1].strip(b' "\t').decode("utf-8", "surrogateescape") for match in found if match)
    return [name for name in names if name]
