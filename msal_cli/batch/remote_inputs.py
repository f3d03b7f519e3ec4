"""Which objects an input URL stands for: one object, all below a folder, or a pattern.

A folder costs one listing, whatever lies in it, and the listing brings size and tag of every
object, so that nothing has to be asked again to tell what is up to date.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from msal_cli.batch.patterns import Patterns, has_magic
from msal_cli.batch.temporary_files import is_own
from msal_cli.errors import InputError, UsageError
from msal_cli.job.records import ObjectMark
from msal_cli.storage import objects as remote
from msal_cli.storage import urls

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Object:
    """One object; ``relative`` is its name below ``root``, the folder that was searched.

    ``root`` is empty for an object that was named itself.
    """

    url: str
    relative: str
    root: str
    mark: ObjectMark


@dataclass(frozen=True, slots=True)
class Place:
    """What an input URL is: ``file``, ``folder`` or ``pattern``; a file has its ``mark``."""

    url: str
    kind: str
    mark: ObjectMark | None = None


def place(url: str, is_mesh_name: Callable[[str], bool]) -> Place:
    """What a URL is; for a folder nothing is asked before it is listed.

    Raises UsageError if the store does not answer, or the URL names no place in it.
    """
    path = urls.split(url)[1]
    if not path.strip("/"):
        raise UsageError(f"{url!r} names no bucket or folder", path=url)
    otherwise = "pattern" if has_magic(path) else "folder"
    if url.endswith("/") or not (otherwise == "pattern" or is_mesh_name(urls.name(url))):
        return Place(url, otherwise)
    mark = _asked(lambda: remote.mark(url))
    return Place(url, otherwise) if mark is None else Place(url, "file", ObjectMark(*mark))


def found(
    one: Place, prefix: str, is_mesh_name: Callable[[str], bool], output: str | None
) -> list[Object]:
    """The objects that a URL stands for, by name; hidden ones are passed over.

    Parameters
    ----------
    prefix : what the relative names begin with.
    output : where the run writes to; objects below it are no inputs, unless the URL is there too.

    Raises UsageError if there is nothing, or the store does not answer.
    """
    url = one.url
    if one.mark is not None:
        return [Object(url, urls.name(url), "", one.mark)]
    own = urls.identity(urls.folder(output)) if output is not None and urls.is_url(output) else None
    if one.kind == "pattern":
        return list(_by_pattern(url, is_mesh_name, own))
    marks = _asked(lambda: remote.listed(url))
    if not marks:
        # It may be an object whose name has no suffix of a mesh.
        mark = None if url.endswith("/") else _asked(lambda: remote.mark(url))
        if mark is None:
            raise _nothing(url)
        return [Object(url, urls.name(url), "", ObjectMark(*mark))]
    return [
        Object(urls.joined(url, name), prefix + name, url, ObjectMark(*marks[name]))
        for name in _visible(url, marks, own, with_hidden=False)
        if is_mesh_name(name.rpartition("/")[2])
    ]


def _nothing(url: str) -> UsageError:
    return UsageError(
        f"there is no object or folder {url!r}",
        hint="check the bucket, the name, and AWS_ENDPOINT_URL or its like",
        path=url,
    )


def _by_pattern(url: str, is_mesh_name: Callable[[str], bool], own: str | None) -> Iterator[Object]:
    protocol, path = urls.split(url)
    parts = path.rstrip("/").split("/")
    n_fixed = next(at for at, part in enumerate(parts) if has_magic(part))
    folder, rest = f"{protocol}://{'/'.join(parts[:n_fixed])}", parts[n_fixed:]
    if not any(parts[:n_fixed]):
        raise UsageError(f"the pattern {url!r} names no bucket or folder", path=url)
    matcher = Patterns(["/".join(rest)], whole=True)
    takes_any_name = "." in rest[-1] and not has_magic(rest[-1].rpartition(".")[2])
    # A pattern for names of files needs no look into deeper folders; another may match a folder.
    depth = len(rest) if takes_any_name and "**" not in rest else None
    marks = _asked(lambda: remote.listed(folder, depth))
    with_hidden = any(part.startswith(".") for part in rest)
    for name in _visible(folder, marks, own, with_hidden=with_hidden):
        if matcher.matches(name) and (
            (takes_any_name and matcher.is_exact(name)) or is_mesh_name(name.rpartition("/")[2])
        ):
            yield Object(urls.joined(folder, name), name, folder, ObjectMark(*marks[name]))


def _visible(
    folder: str, marks: dict[str, remote.Mark], own: str | None, *, with_hidden: bool
) -> list[str]:
    """Names in order of their parts, without hidden ones, our own, and the run's output."""
    root = urls.identity(urls.folder(folder))
    leaves_out = own is not None and own.startswith(root) and own != root
    inside = own[len(root) :] if leaves_out and own is not None else ""

    def is_passed_over(name: str) -> bool:
        if leaves_out and name.startswith(inside):
            return True
        # ``.`` and ``..`` are odd names, but not hidden ones.
        return any(
            is_own(part) or (part.startswith(".") and part not in (".", "..") and not with_hidden)
            for part in name.split("/")
        )

    names = [name for name in marks if name and not is_passed_over(name)]
    return sorted(names, key=lambda name: name.split("/"))


def _asked(question: Callable[[], T]) -> T:
    """An answer of the store; that there is none refuses the run before it begins."""
    try:
        return question()
    except InputError as error:
        raise UsageError(error.message, hint=error.hint, path=error.path) from None
