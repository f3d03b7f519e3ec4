"""Find the files that the inputs of a command name: files, folders and glob patterns.

The order of the files is that of the inputs and, within a folder, that of the names; it does
not depend on the file system.  Names are only compared and joined, never interpreted, so any
name that the system allows (line breaks, bytes that are not UTF-8, a leading dash) works.
"""

import fnmatch
import logging
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from msal_cli.codecs.detection import READABLE, format_of_name
from msal_cli.errors import InputError, MissingInputError, MsalError, UsageError
from msal_cli.light_dataclass import dataclass
from msal_cli.storage import urls
from msal_cli.storage.atomic import is_manifest, is_own
from msal_cli.storage.urls import ObjectMark, is_url

_LINKS_NAMED = 3

_log = logging.getLogger("msal.batch")


class NothingMatched(MsalError):  # noqa: N818 - a signal to the command line, not a fault
    """The inputs exist, but contain no mesh file that the patterns select (exit status 5)."""

    code = "E_NOTHING_MATCHED"


@dataclass(frozen=True, slots=True)
class DiscoveredInput:
    """One input file.

    ``path`` is the path or URL to open; ``relative`` is its path below an output folder, with
    ``/``; ``root`` is the folder that was searched, or ``""`` for an input that is a file itself.
    ``mark`` is the size and tag that a store gave for an object when it was found.
    """

    path: str
    relative: str
    root: str
    mark: ObjectMark | None = None


class _Selection:
    """Which files below a folder an input selects: those with mesh names, or those of a pattern.

    A pattern that ends in a plain suffix selects every file that it matches; any other may match
    a folder, whose meshes it selects.  ``depth`` is the most parts of a name, None if unlimited.
    """

    def __init__(self, parts: Sequence[str]) -> None:
        self._parts = parts
        last = parts[-1] if parts else ""
        self._takes_any_name = "." in last and not has_magic(last.rpartition(".")[2])
        self._depth = len(parts) if parts and "**" not in parts else None
        self.is_pattern = bool(parts)
        self.depth = self._depth if self._takes_any_name else None
        self.with_hidden = any(part.startswith(".") for part in parts)

    def takes(self, relative: str) -> bool:
        if not self._matches(relative):
            return False
        is_named = self._takes_any_name and _match(self._parts, relative.split("/"))
        return is_named or format_of_name(relative) != ""

    def may_lie_below(self, relative: str) -> bool:
        """Whether files below this folder may be selected."""
        if self._depth is None or relative.count("/") + 1 < self._depth:
            return True
        return self._matches(relative)

    def _matches(self, relative: str) -> bool:
        """Whether there is no pattern, or it matches ``relative`` or a folder above it."""
        return not self._parts or _match_above(self._parts, relative.split("/"))


def discover_inputs(
    inputs: Sequence[str],
    include: Sequence[str] = (),
    exclude: Sequence[str] = (),
    *,
    output: str | None = None,
    failures: list[MsalError] | None = None,
    warn: Callable[[str], None] = _log.warning,
) -> tuple[DiscoveredInput, ...]:
    """The files that ``inputs`` name, each once, in a fixed order.

    An input ``protocol://...`` is an object, a folder of objects or a pattern in a store.

    A file is selected whatever its name.  A folder is searched through all its subfolders for
    names with a suffix that msal reads; hidden files and folders, special files, msal's own files,
    symbolic links to folders and the folder ``output`` are skipped.  A pattern (``*``, ``?``,
    ``[...]``, ``**``) is expanded unless a file has exactly this name.  One that ends in a plain
    suffix selects every file it matches, any other mesh names and the meshes of folders.

    ``include`` and ``exclude`` are patterns for the relative path, the name, or a folder above
    (see `parse_patterns`); a file is kept if an ``include``, if any, and no ``exclude`` matches.

    Raises UsageError if an input does not exist or is neither file nor folder, and NothingMatched
    if no file is left.  With a list ``failures``, the error of a folder that cannot be listed is
    added to it, and raised as UsageError only if no file is left.  ``warn`` gets warnings.
    """
    included, excluded = parse_patterns(include), parse_patterns(exclude)
    output = None if output is None else urls.normalize_url(output)
    own_output = None if output is None or is_url(output) else str(resolve(Path(output)))
    inputs = [urls.normalize_url(text) for text in inputs]
    types = [find_type(text) for text in inputs]
    folders = {
        text if is_url(text) else str(Path(text))
        for text, (input_type, _) in zip(inputs, types, strict=True)
        if input_type == "folder"
    }
    everything: dict[tuple[str, str], DiscoveredInput] = {}
    empty: list[str] = []
    for text, (input_type, mark) in zip(inputs, types, strict=True):
        found: Iterable[DiscoveredInput]
        if input_type == "file":
            path = text if is_url(text) else str(Path(text))
            name = urls.name(text) if is_url(text) else Path(text).name
            found = [DiscoveredInput(path, name, "", mark)]
        else:
            prefix = f"{_folder_name(text)}/" if input_type == "folder" and len(folders) > 1 else ""
            root, parts = _split_pattern(text) if input_type == "pattern" else (text, ())
            if is_url(text):
                try:
                    found = _list_store(root, prefix, _Selection(parts), output)
                except InputError as error:
                    if failures is None:
                        raise _refusal(error) from error
                    failures.append(error)
                    continue
            else:
                found = _list_tree(
                    Path(root), prefix, _Selection(parts), excluded, own_output, failures, warn
                )
        kept = [
            file
            for file in found
            if (not included or is_matched(included, file.relative))
            and not is_matched(excluded, file.relative)
        ]
        empty += [] if kept else [text]
        for file in kept:
            everything.setdefault((file.path, file.relative), file)
    if not everything and failures:
        raise _refusal(failures[0])
    if not everything:
        raise NothingMatched(
            f"no mesh file is selected by {', '.join(repr(text) for text in inputs)}",
            hint=f"read are {', '.join(READABLE)}; look at the suffixes, --include and --exclude",
        )
    for text in empty:
        warn(f"no mesh file is selected by the input {text!r}")
    return tuple(everything.values())


def find_type(text: str) -> tuple[str, ObjectMark | None]:
    """``file``, ``folder`` or ``pattern``, and the mark of an object.

    In a store only a name that may be a single object is looked up; folders are listed later.
    A broken link, or a mesh in a store that does not answer, counts as a file, so that it becomes
    a failed row with its reason.  Raises UsageError if it does not exist or cannot be read.
    """
    if not is_url(text):
        return _local_type(text), None
    from msal_cli.storage import objects

    path = urls.split(text)[1]
    if not path.strip("/"):
        raise UsageError(f"{text!r} names no bucket or folder", path=text)
    other = "pattern" if has_magic(path) else "folder"
    may_be_object = other == "pattern" or format_of_name(urls.name(text)) != ""
    try:
        mark = objects.mark(text) if may_be_object and not text.endswith("/") else None
    except InputError:
        return "file" if other == "folder" else other, None
    return (other, None) if mark is None else ("file", mark)


def _local_type(text: str) -> str:
    if not text:
        raise UsageError("an input is the empty string")
    path = Path(text)
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        if os.path.islink(text):
            return "file"
        if isinstance(error, OSError) and has_magic(text):
            return "pattern"
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            raise MissingInputError(f"there is no file or folder {text!r}", path=text) from None
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


def _folder_name(text: str) -> str:
    if is_url(text):
        return urls.name(text)
    folder = Path(text)
    return folder.name if folder.name not in ("", "..") else resolve(folder).name or "root"


def _split_pattern(text: str) -> tuple[str, Sequence[str]]:
    """Split a pattern into its leading folder without wildcards and the parts after that."""
    protocol, path = urls.split(text) if is_url(text) else ("", text)
    parts = path.rstrip("/").split("/") if protocol else Path(text).parts
    n_fixed = next(at for at, part in enumerate(parts) if has_magic(part))
    if not protocol:
        return str(Path(*parts[:n_fixed])), parts[n_fixed:]
    if not any(parts[:n_fixed]):
        raise UsageError(f"the pattern {text!r} names no bucket or folder", path=text)
    return f"{protocol}://{'/'.join(parts[:n_fixed])}", parts[n_fixed:]


# In a store


def _list_store(
    url: str, prefix: str, selection: _Selection, output: str | None
) -> list[DiscoveredInput]:
    """The selected objects below a URL, by name; the object itself if the URL names one.

    One listing gives size and tag of every object.  Hidden objects, msal's own and those below
    ``output`` are skipped, the latter unless the URL is below it, too.
    """
    from msal_cli.storage import objects

    marks = objects.list_objects(url, selection.depth)
    # Nothing is listed for an object without a mesh suffix, and for a server that is down.
    mark = None if marks else objects.mark(url)
    if not marks and not selection.is_pattern:
        if mark is not None and not url.endswith("/"):
            return [DiscoveredInput(url, urls.name(url), "", mark)]
        raise UsageError(
            f"there is no object or folder {url!r}",
            hint="check the name, and of a store the bucket and AWS_ENDPOINT_URL or its like",
            path=url,
        )
    root = urls.identity(urls.folder(url))
    own = urls.identity(urls.folder(output)) if output is not None and is_url(output) else root
    own_output = own[len(root) :] if own.startswith(root) else ""

    def is_taken(name: str) -> bool:
        if not name or (own_output and name.startswith(own_output)):
            return False
        # The names ``.`` and ``..``, which an object may have, do not hide it.
        parts = [part for part in name.split("/") if part not in (".", "..")]
        is_hidden = any(_is_skipped(part, selection.with_hidden) for part in parts)
        return not is_hidden and selection.takes(name)

    return [
        DiscoveredInput(urls.folder(url) + name, prefix + name, url, marks[name])
        for name in sorted(filter(is_taken, marks), key=lambda name: name.split("/"))
    ]


def _refusal(error: MsalError) -> UsageError:
    return UsageError(error.message, hint=error.hint, path=error.path)


# On this machine


def _list_tree(
    root: Path,
    prefix: str,
    selection: _Selection,
    excluded: Sequence[Sequence[str]],
    own_output: str | None,
    failures: list[MsalError] | None,
    warn: Callable[[str], None],
) -> Iterator[DiscoveredInput]:
    """The selected files below a folder, by name; ``failures`` as for `discover_inputs`."""
    if selection.is_pattern and not root.is_dir():
        return
    real_root, has_output = str(resolve(root)), own_output is not None
    # If the searched folder lies in the output folder, the user named it on purpose.
    if own_output is not None and _is_below(own_output, real_root):
        own_output = None
    waiting = [(str(root), "", True)]
    outside: list[str] = []
    while waiting:
        place, relative, is_folder = waiting.pop()
        if not is_folder:
            if selection.takes(relative):
                yield DiscoveredInput(place, prefix + relative, str(root))
            continue
        below: list[tuple[str, str, bool]] = []
        entries = _scan(place, failures)
        if relative and has_output and any(is_manifest(entry.name) for entry in entries):
            warn(
                f"the folder {place!r} holds results of an earlier run, "
                "and they are inputs of this one; --exclude leaves them out"
            )
        for entry in entries:
            if _is_skipped(entry.name, selection.with_hidden):
                continue
            path = entry.name if place == "." else os.path.join(place, entry.name)
            name = f"{relative}/{entry.name}" if relative else entry.name
            file_type = _file_type(entry)
            if file_type == "file":
                below.append((path, name, False))
            elif file_type == "special" or is_matched(excluded, prefix + name):
                continue
            elif file_type == "linked folder":
                # A target within the searched folder is found at its own place.
                if not _is_below(real_root, str(resolve(Path(path)))):
                    outside.append(path)
            elif selection.may_lie_below(name) and os.path.join(real_root, name) != own_output:
                below.append((path, name, True))
        waiting += sorted(below, key=lambda item: item[1], reverse=True)
    for link in sorted(outside)[:_LINKS_NAMED]:
        warn(
            f"the link {link!r} leads out of the input folder {str(root)!r} and is skipped; "
            "name the folder itself as an input to have it too"
        )
    if len(outside) > _LINKS_NAMED:
        warn(f"{len(outside) - _LINKS_NAMED} more links lead out of it")


def _is_skipped(name: str, with_hidden: bool) -> bool:
    return is_own(name) or (name.startswith(".") and not with_hidden)


def _scan(folder: str, failures: list[MsalError] | None) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except FileNotFoundError:
        return []
    except OSError as error:
        failure = InputError(
            f"the folder {folder!r} cannot be listed: {error.strerror}",
            hint="make it readable, or leave it out with --exclude",
            path=folder,
            code="E_READ",
        )
    if failures is None:
        raise _refusal(failure)
    failures.append(failure)
    return []


def _file_type(entry: os.DirEntry[str]) -> str:
    try:
        if entry.is_dir(follow_symlinks=False):
            return "folder"
        if entry.is_file(follow_symlinks=False):
            return "file"
        if not entry.is_symlink():
            return "special"
        mode = entry.stat().st_mode
    except OSError:
        # A broken or circular link counts as a file, so that it becomes a failed row with its
        # reason, and is not left out.
        return "file"
    if stat.S_ISDIR(mode):
        return "linked folder"
    return "file" if stat.S_ISREG(mode) else "special"


def _is_below(folder: str, path: str) -> bool:
    """Whether ``path`` is ``folder`` or lies below it; both must be resolved."""
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def resolve(path: Path) -> Path:
    """The absolute path with links followed, as far as the system can follow them.

    Raises UsageError for a path with a NUL character.
    """
    try:
        return path.resolve()
    except ValueError as error:
        raise UsageError(f"{str(path)!r} cannot be opened: {error}", path=str(path)) from None
    except (OSError, RuntimeError):
        return Path.cwd() / path


# Patterns


def has_magic(text: str) -> bool:
    return re.search(r"[*?[]", text) is not None


def parse_patterns(patterns: Iterable[str]) -> list[list[str]]:
    """Split glob patterns into parts, for ``is_matched``.

    Relative paths are written with ``/``.  A pattern matches a file when it matches its whole
    relative path, its name alone, or a folder above it: ``old`` and ``old/`` match everything
    in a folder ``old`` anywhere, and ``left/**/*.ply`` matches ``left/a.ply`` as well as
    ``left/b/c.ply``.  As in a shell, a wildcard at the start of a name does not match a dot.
    Case matters, except on Windows.

    Raises UsageError for an empty pattern.
    """
    parsed = []
    for pattern in patterns:
        parts = pattern.replace(os.sep, "/").rstrip("/").split("/")
        while parts[:1] == ["."]:
            del parts[0]
        if parts in ([], [""]):
            raise UsageError(f"the pattern {pattern!r} is empty")
        parsed.append(parts)
    return parsed


def is_matched(patterns: Sequence[Sequence[str]], relative: str) -> bool:
    """Whether a pattern matches ``relative``, its name or a folder above it."""
    parts = relative.split("/")
    return any(
        _match_above(pattern, parts) or any(_match(pattern, [part]) for part in parts)
        for pattern in patterns
    )


def _match_above(pattern: Sequence[str], parts: Sequence[str]) -> bool:
    """Whether a pattern matches a path or a folder above it."""
    return any(_match(pattern, parts[:stop]) for stop in range(len(parts), 0, -1))


def _match(pattern: Sequence[str], parts: Sequence[str]) -> bool:
    """Whether the parts of a pattern match all parts of a path."""
    if not (pattern and parts):
        return not (pattern or parts)
    first, rest = pattern[0], pattern[1:]
    if first == "**":
        return not rest or any(_match(rest, parts[at:]) for at in range(len(parts)))
    if parts[0].startswith(".") and first[0:1] in ("*", "?", "["):
        return False
    # A name may contain wildcard characters itself.
    is_match = parts[0] == first or fnmatch.fnmatch(parts[0], first)
    return is_match and _match(rest, parts[1:])
