"""Which files the inputs of a command stand for: files, folders and glob patterns.

The order of what is found is that of the inputs and, within a folder, that of the names; it does
not depend on the file system.  Names are only ever compared and joined, never interpreted, so any
name that the system allows (line breaks, bytes that are no UTF-8, a leading dash) is fine.
"""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli.batch.patterns import Patterns, has_magic
from msal_cli.batch.temporary_files import is_own
from msal_cli.errors import MsalError, UsageError
from msal_cli.job.records import ObjectMark
from msal_cli.storage.urls import is_url, name, settled

if TYPE_CHECKING:
    from msal_cli.batch.remote_inputs import Place

_LINKS_NAMED = 3

_log = logging.getLogger("msal.batch")


class NothingMatched(MsalError):  # noqa: N818 - a signal to the command line, not a fault
    """The inputs exist, but hold no mesh file that the patterns let through (exit status 5)."""

    code = "E_NOTHING_MATCHED"


@dataclass(frozen=True, slots=True)
class Found:
    """One input file.

    ``path`` opens it; ``relative`` is where it belongs below an output folder, written with ``/``;
    ``root`` is the folder that was searched, or ``""`` for a file that was named itself.  An
    object in a store has the ``mark`` that the store told when it was found.
    """

    path: str
    relative: str
    root: str
    mark: ObjectMark | None = None


@dataclass(frozen=True, slots=True)
class _Entry:
    path: str
    name: str
    relative: str
    is_folder: bool


def found(
    inputs: Sequence[str],
    include: Iterable[str] = (),
    exclude: Iterable[str] = (),
    is_mesh_name: Callable[[str], bool] | None = None,
    *,
    output: str | None = None,
) -> tuple[Found, ...]:
    """The files that ``inputs`` stand for, each once, in a fixed order.

    What is written as ``protocol://...`` is an object, a folder of objects or a pattern in a store
    (see `remote_inputs`).

    A file is taken as it is, whatever its name.  A folder is searched through all its subfolders
    for names that ``is_mesh_name`` accepts (default: every suffix that msal reads); hidden files
    and folders, special files, msal's own files and the folder ``output`` are passed over.  A
    symbolic link to a folder is followed when it leads elsewhere within the searched folder, but
    not from there through another link, so a loop ends; a link that leads out of it is passed
    over.  A pattern (``*``, ``?``, ``[...]``, ``**``) is expanded here unless a file of that very
    name exists: a pattern that ends in a plain suffix takes every file it matches, another only
    mesh names, and a folder that it matches is searched.

    ``include`` and ``exclude`` are patterns on the relative path, the name, or a folder on the way
    (see `patterns.Patterns`); a file is kept if some ``include`` (where there is any) and no
    ``exclude`` matches.

    Raises
    ------
    UsageError : an input does not exist or is neither file nor folder; a folder cannot be listed.
    NothingMatched : nothing is left.
    """
    if is_mesh_name is None:
        from msal_cli.job.settings import is_mesh_name as known_suffix

        is_mesh_name = known_suffix
    included, excluded = Patterns(include), Patterns(exclude)
    inputs = [settled(text) for text in inputs]
    places = {text: _place(text, is_mesh_name) for text in inputs if is_url(text)}
    kinds = [places[text].kind if text in places else _kind(text) for text in inputs]
    folders = {
        text if text in places else str(Path(text))
        for text, kind in zip(inputs, kinds, strict=True)
        if kind == "folder"
    }
    output = None if output is None else settled(output)
    own_output = resolve(Path(output)) if output is not None and not is_url(output) else None
    everything: dict[tuple[str, str], Found] = {}
    empty: list[str] = []
    for text, kind in zip(inputs, kinds, strict=True):
        if text in places:
            from msal_cli.batch import remote_inputs

            prefix = f"{name(text)}/" if kind == "folder" and len(folders) > 1 else ""
            objects = remote_inputs.found(places[text], prefix, is_mesh_name, output)
            some = [Found(one.url, one.relative, one.root, one.mark) for one in objects]
        elif kind == "file":
            some = [Found(str(Path(text)), Path(text).name, "")]
        elif kind == "folder":
            prefix = f"{_folder_name(Path(text))}/" if len(folders) > 1 else ""
            some = _in_folder(Path(text), prefix, is_mesh_name, excluded, own_output)
        else:
            some = _by_pattern(text, is_mesh_name, excluded, own_output)
        kept = [
            one
            for one in some
            if (not included or included.matches(one.relative))
            and not excluded.matches(one.relative)
        ]
        if not kept:
            empty.append(text)
        for one in kept:
            everything.setdefault((one.path, one.relative), one)
    if not everything:
        raise NothingMatched(
            f"no mesh file is selected by {', '.join(repr(text) for text in inputs)}",
            hint="look at the suffixes, and at --include and --exclude",
        )
    for text in empty:
        _log.warning("no mesh file is selected by the input %r", text)
    return tuple(everything.values())


def _place(url: str, is_mesh_name: Callable[[str], bool]) -> Place:
    from msal_cli.batch.remote_inputs import place

    return place(url, is_mesh_name)


def _kind(text: str) -> str:
    if not text:
        raise UsageError("an input is the empty string")
    path = Path(text)
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and has_magic(text) and not path.is_symlink():
            return "pattern"
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            if path.is_symlink():
                raise UsageError(f"the link {text!r} leads to nothing", path=text) from None
            raise UsageError(f"there is no file or folder {text!r}", path=text) from None
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UsageError(f"{text!r} cannot be opened: {reason}", path=text) from None
    if stat.S_ISDIR(mode):
        return "folder"
    if stat.S_ISREG(mode):
        return "file"
    raise UsageError(
        f"{text!r} is neither a file nor a folder",
        hint="a pipe is read through standard input: give - as the input",
        path=text,
    )


def _folder_name(folder: Path) -> str:
    return folder.name if folder.name not in ("", "..") else resolve(folder).name or "root"


def _in_folder(
    folder: Path,
    prefix: str,
    is_mesh_name: Callable[[str], bool],
    excluded: Patterns,
    own_output: Path | None,
) -> list[Found]:
    def is_entered(relative: str) -> bool:
        return not excluded.matches(prefix + relative)

    return [
        Found(entry.path, prefix + entry.relative, str(folder))
        for entry in _walked(folder, own_output, is_entered)
        if not entry.is_folder and is_mesh_name(entry.name)
    ]


def _by_pattern(
    text: str,
    is_mesh_name: Callable[[str], bool],
    excluded: Patterns,
    own_output: Path | None,
) -> list[Found]:
    parts = Path(text).parts
    n_fixed = next(at for at, part in enumerate(parts) if has_magic(part))
    folder, rest = Path(*parts[:n_fixed]), parts[n_fixed:]
    if not folder.is_dir():
        return []
    matcher = Patterns(["/".join(rest)], whole=True)
    takes_any_name = "." in rest[-1] and not has_magic(rest[-1].rpartition(".")[2])
    depth = None if "**" in rest else len(rest)

    def is_entered(relative: str) -> bool:
        if excluded.matches(relative):
            return False
        return depth is None or relative.count("/") + 1 < depth or matcher.matches(relative)

    entries = _walked(folder, own_output, is_entered, any(p.startswith(".") for p in rest))
    return [
        Found(entry.path, entry.relative, str(folder))
        for entry in entries
        if not entry.is_folder
        and matcher.matches(entry.relative)
        and ((takes_any_name and matcher.is_exact(entry.relative)) or is_mesh_name(entry.name))
    ]


def _walked(
    root: Path,
    own_output: Path | None,
    is_entered: Callable[[str], bool],
    with_hidden: bool = False,
) -> Iterator[_Entry]:
    """Files and folders below ``root``, by name; a folder comes before what it holds."""
    real_root = str(resolve(root))
    # What lies in a searched folder that itself lies in the output was asked for by name.
    passed_over = None if own_output is None else str(own_output)
    if passed_over is not None and _holds(passed_over, real_root):
        passed_over = None
    # Each folder waits with its real path, which costs too much to ask for at every depth, and with
    # the answer to: was a link followed on the way to it?
    waiting: list[tuple[_Entry, str, bool]] = [(_Entry(str(root), "", "", True), real_root, False)]
    outside: list[str] = []
    while waiting:
        entry, holder, is_beyond_link = waiting.pop()
        if entry.relative:
            yield entry
        if not entry.is_folder:
            continue
        below: list[tuple[_Entry, str, bool]] = []
        for one in _listed(entry.path):
            if _is_passed_over(one.name, with_hidden):
                continue
            path = one.name if entry.path == "." else os.path.join(entry.path, one.name)
            relative = f"{entry.relative}/{one.name}" if entry.relative else one.name
            kind = _entry_kind(one)
            if kind == "file":
                below.append((_Entry(path, one.name, relative, False), "", is_beyond_link))
            elif kind != "special" and is_entered(relative):
                is_link = kind == "linked folder"
                real = str(resolve(Path(path))) if is_link else os.path.join(holder, one.name)
                if passed_over is not None and _holds(passed_over, real):
                    continue
                if is_link and not _holds(real_root, real):
                    outside.append(path)
                    continue
                # A link to a folder that holds it leads round.
                if is_link and (is_beyond_link or _holds(real, holder)):
                    continue
                folder = _Entry(path, one.name, relative, True)
                below.append((folder, real, is_beyond_link or is_link))
        below.sort(key=lambda triple: triple[0].name, reverse=True)
        waiting.extend(below)
    _warn_outside(sorted(outside), root)


def _warn_outside(links: Sequence[str], root: Path) -> None:
    for link in links[:_LINKS_NAMED]:
        _log.warning(
            "the link %r leads out of the input folder %r and is skipped; "
            "name the folder itself as an input to have it too",
            link,
            str(root),
        )
    if len(links) > _LINKS_NAMED:
        _log.warning("%d more links lead out of it", len(links) - _LINKS_NAMED)


def _is_passed_over(name: str, with_hidden: bool) -> bool:
    return is_own(name) or (name.startswith(".") and not with_hidden)


def _listed(folder: str) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise UsageError(
            f"the folder {folder!r} cannot be listed: {error.strerror}",
            hint="make it readable, or leave it out with --exclude",
            path=folder,
        ) from None


def _entry_kind(entry: os.DirEntry[str]) -> str:
    try:
        if entry.is_dir(follow_symlinks=False):
            return "folder"
        if entry.is_file(follow_symlinks=False):
            return "file"
        if not entry.is_symlink():
            return "special"
        mode = entry.stat().st_mode
    except OSError:
        # A link to nothing, or in a circle, is taken for a file so that it ends as a failed row
        # with its reason, and not as a scan that nobody misses.
        return "file"
    if stat.S_ISDIR(mode):
        return "linked folder"
    return "file" if stat.S_ISREG(mode) else "special"


def _holds(folder: str, path: str) -> bool:
    """Whether a path is that of a folder, or lies below it; both are real paths."""
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def resolve(path: Path) -> Path:
    """The absolute path with links followed, as far as the system can follow them."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return Path.cwd() / path
