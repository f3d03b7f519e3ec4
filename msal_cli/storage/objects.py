"""Objects behind URLs, through fsspec: read whole, write whole, size and tag, listing.

An object appears whole or not at all.  Object stores guarantee that for a single put, and for an
upload in parts once it is completed; servers of files (SFTP, SMB, ...) are only read from.  Nothing
is opened for writing and left to a destructor to close.

Nothing is cached: each call asks the store.
"""

import contextlib
import inspect
import re
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from msal_cli.errors import InputError, MsalError, OutputError, UsageError, install_hint
from msal_cli.storage import urls
from msal_cli.storage.regular import Buffer, largest_bytes, too_large
from msal_cli.storage.urls import ObjectMark

# Stores whose put is atomic; for all others that is not known.
_OBJECT_STORES = re.compile("s3a?|gs|gcs|az|abfss?|adl|oss|memory|https?")

# s3fs retries what botocore has already retried: without this limit, each file in a store that
# cannot be reached would take minutes.
_TRIES_AROUND_BOTOCORE = 2

_MAX_THREADS = 16
_MAX_REMOVED = 1000

_TAGS = ("ETag", "etag", "md5Hash", "content_md5", "md5", "checksum", "generation")
_TIMES = ("LastModified", "last_modified", "mtime", "modified", "updated", "created")

_lock = threading.Lock()
_file_systems: dict[tuple[str, str], Any] = {}


def read_whole(url: str, size: int | None = None) -> bytes:
    """The bytes of an object; ``size`` is its size in a recent listing, if known.

    Raises InputError (``E_READ``) if it is missing, or the store does not deliver it; TooLargeError
    if it has more than half of the machine's memory; UsageError if a package is missing.
    """
    with _opened(url, "the object cannot be read") as (system, path):
        if size is None or size < 0:
            known = _mark(system, path)
            size = known.size if known is not None else 0
        if size > largest_bytes():
            raise too_large(size)
        # Parts that are fetched in parallel may be from two versions of the object.
        cat = getattr(system, "_cat_file", None)
        takes_limit = cat is not None and "max_concurrency" in inspect.signature(cat).parameters
        data: bytes = system.cat_file(path, **({"max_concurrency": 1} if takes_limit else {}))
    return data


@contextlib.contextmanager
def _opened(url: str, message: str, *, is_output: bool = False) -> Iterator[tuple[Any, str]]:
    """The file system of a URL and the path in it; errors in the block become InputError
    (``E_READ``) or OutputError."""
    try:
        yield _open(url)
    except (MsalError, MemoryError):
        raise
    except Exception as failure:
        reason, hint = _explain(failure)
        if not is_output:
            raise InputError(f"{message}: {reason}", path=url, code="E_READ", hint=hint) from None
        if isinstance(failure, FileNotFoundError):
            reason, hint = "there is no such bucket or folder", "check the output's name"
        raise OutputError(f"{message}: {reason}", path=url, hint=hint) from None


def read_beginning(url: str, length: int) -> tuple[bytes, int]:
    """At most ``length`` bytes from the beginning of an object, and its size; two requests.

    Raises InputError (``E_READ``) if it is missing; UsageError if a package is missing.
    """
    there = mark(url)
    if there is None:
        raise InputError("there is no such object", path=url, code="E_READ")
    data = b""
    with _opened(url, "the object cannot be read") as (system, path):
        if there.size:
            # An empty range is an error in some stores; a web server may ignore the range.
            data = system.cat_file(path, start=0, end=length)[:length]
    return data, max(there.size, len(data))


def read_many(marks: Mapping[str, ObjectMark]) -> list[bytes]:
    """The bytes of several objects with the marks of a listing, in parallel.

    Raises as ``read_whole`` does, with the limit of memory for all of them together.
    """
    if not marks:
        return []
    from concurrent.futures import ThreadPoolExecutor

    sizes = [mark.size for mark in marks.values()]
    together = sum(max(size, 0) for size in sizes)
    if together > largest_bytes():
        raise too_large(together)
    with ThreadPoolExecutor(min(_MAX_THREADS, len(marks))) as pool:
        return list(pool.map(read_whole, marks, sizes))


def write_whole(url: str, buffers: Buffer | Iterable[Buffer]) -> ObjectMark:
    """Write an object so that it is seen whole or not at all; returns its mark from the store.

    Raises OutputError if the store refuses it; UsageError if a package is missing.
    """
    if isinstance(buffers, bytes | bytearray | memoryview):
        buffers = (buffers,)
    data = b"".join(buffers)
    with _opened(url, "the object cannot be written", is_output=True) as (system, path):
        if not _OBJECT_STORES.fullmatch(urls.split(url)[0]):
            raise OutputError(
                "objects are written to object stores only: others may show a part of one",
                path=url,
                hint="write to a folder, and copy it; or mount the server (sshfs, rclone)",
            )
        system.pipe_file(path, data)
        there = _mark(system, path)
    if there is None or there.size != len(data):
        size = "none" if there is None else f"{there.size:,}"
        raise OutputError(
            f"the object cannot be written: {size} of {len(data):,} bytes arrived",
            path=url,
            hint="run again; check whether another program writes there",
        )
    return there


def mark(url: str) -> ObjectMark | None:
    """Size and tag of an object; None if there is none (folders are not objects).

    Raises InputError (``E_READ``) if the store does not answer; UsageError if a package is missing.
    """
    with _opened(url, "the object cannot be inspected") as (system, path):
        return _mark(system, path)


def list_objects(url: str, depth: int | None = None) -> dict[str, ObjectMark]:
    """The objects below a folder by their names there, with ``/``, of at most ``depth`` parts.

    Object stores list a thousand objects per request, at any depth.  Raises as ``mark`` does.
    """
    with _opened(url, "the folder cannot be listed") as (system, path):
        system.invalidate_cache()
        limit = {} if depth is None else {"maxdepth": depth}
        found: dict[str, dict[str, Any]] = {}
        with contextlib.suppress(FileNotFoundError):
            found = system.find(path, detail=True, **limit)
    start = path.rstrip("/") + "/"
    return {
        full[len(start) :]: _mark_of(info)
        for full, info in found.items()
        if full.startswith(start) and len(full) > len(start) and info.get("type") != "directory"
    }


def remove_objects(object_urls: Sequence[str]) -> None:
    """Remove objects of one store, where that is allowed; failures are ignored."""
    if not object_urls:
        return
    with contextlib.suppress(Exception):
        opened = [_open(url) for url in object_urls]
        system = opened[0][0]
        paths = [path for _, path in opened]
        if hasattr(system, "bulk_delete"):
            for start in range(0, len(paths), _MAX_REMOVED):
                system.bulk_delete(paths[start : start + _MAX_REMOVED])
            return
        for path in paths:
            system.rm_file(path)


def _open(url: str) -> tuple[Any, str]:
    protocol = urls.split(url)[0]
    try:
        import fsspec

        kind: Any = fsspec.get_filesystem_class(protocol)
    except ImportError as failure:
        # For a known protocol, fsspec's message says what to install.
        is_extra = protocol in ("s3", "s3a", "gs", "gcs") or failure.name == "fsspec"
        raise UsageError(
            f"{protocol}:// cannot be used: {_one_line(failure)}",
            hint=install_hint("cloud") if is_extra else "",
        ) from None
    except ValueError:
        raise UsageError(
            f"the protocol of {protocol}:// is not known",
            hint="URLs are those of fsspec, such as s3://bucket/scans",
        ) from None
    is_s3 = protocol in ("s3", "s3a")
    if is_s3 and "?versionId=" in url:
        # s3fs would cut the name there, and use another object.
        raise ValueError("a name with ?versionId= in it cannot be distinguished from a version")
    options = {} if is_s3 else dict(kind._get_kwargs_from_urls(url))
    path: str = kind._strip_protocol(url)
    # Shared by all threads, so that they share connections.
    key = (protocol, repr(sorted(options.items())))
    with _lock:
        if key not in _file_systems:
            try:
                system = fsspec.filesystem(protocol, **options)
            except (ImportError, TypeError, ValueError) as failure:
                raise UsageError(
                    f"{protocol}:// cannot be used: {urls.redact(_one_line(failure))}",
                    hint="chained URLs and archives are not supported",
                ) from None
            if isinstance(getattr(system, "retries", None), int):
                system.retries = min(system.retries, _TRIES_AROUND_BOTOCORE)
            _file_systems[key] = system
        return _file_systems[key], path


def _mark(system: Any, path: str) -> ObjectMark | None:
    system.invalidate_cache()
    try:
        info: dict[str, Any] = system.info(path)
    except (FileNotFoundError, NotADirectoryError) as failure:
        # fsspec also raises this for a web server that cannot be reached.
        if isinstance(failure.__cause__, OSError):
            raise failure.__cause__ from None
        return None
    return None if info.get("type") == "directory" else _mark_of(info)


def _mark_of(info: dict[str, Any]) -> ObjectMark:
    size = -1 if info.get("size") is None else int(info["size"])
    for key in _TAGS:
        if isinstance(info.get(key), str | int | bytes) and info[key]:
            value = info[key]
            text = value.hex() if isinstance(value, bytes) else str(value)
            return ObjectMark(size, text[1:-1] if text[:1] == text[-1:] == '"' else text)
    for key in _TIMES:
        moment = info.get(key)
        if isinstance(moment, datetime):
            moment = moment.timestamp()
        if isinstance(moment, int | float):
            return ObjectMark(size, f"{key} {moment:.6f}")
        if isinstance(moment, str) and moment:
            return ObjectMark(size, f"{key} {moment}")
    return ObjectMark(size, "")


# Class names of exceptions, because the libraries may be missing; the reason, and what to do.
_EXPLANATIONS = (
    (
        "((CredentialRetrieval|DefaultCredentials|NoCredentials|PartialCredentials|TokenRetrieval)"
        "Error|ProfileNotFound|RefreshError)",
        "there are no credentials ({})",
        "set AWS_PROFILE, AWS_ACCESS_KEY_ID or the store's own variables; "
        "FSSPEC_S3_ANON=true for public buckets",
    ),
    (
        "PermissionError",
        "access is denied ({})",
        "check the credentials and what they may do there",
    ),
    (
        "(ClientConnection|ConnectTimeout|ConnectionClosed|Connection|EndpointConnection|FSTimeout|"
        "HTTPClient|ReadTimeout|Timeout)Error|gaierror",
        "the store cannot be reached ({})",
        "check the address (of S3 AWS_ENDPOINT_URL) and the network; then run again",
    ),
    ("NotImplementedError", "its file system cannot do that", "name another place"),
    ("UnicodeError", "its name is not valid Unicode", "rename it"),
)


def _explain(failure: BaseException) -> tuple[str, str]:
    kinds = {
        kind.__name__
        for error in (failure, failure.__cause__)
        if error is not None
        for kind in type(error).__mro__
    }
    said = urls.redact(_one_line(failure))
    if "FileNotFoundError" in kinds:
        if "bucket" in said.lower():
            return "there is no such bucket", "check the bucket's name"
        return "there is no such object", "it may have been removed meanwhile; check the name"
    for pattern, reason, hint in _EXPLANATIONS:
        if any(re.fullmatch(pattern, kind) for kind in kinds):
            return reason.format(said), hint
    return said, "retry; check the status of the object store"


def _one_line(failure: BaseException) -> str:
    words = " ".join(str(failure).split()) or type(failure).__name__
    return words if len(words) <= 300 else words[:297] + "..."
