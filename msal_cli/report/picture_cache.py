"""Pictures of an earlier page, kept in an archive beside it: a rerun draws only new ones.

They are found by hashes of the input, of the output and of how they are drawn: a file that is
denoised again with another result gets other pictures.
"""

from __future__ import annotations

import hashlib
import io
import os
import zipfile

from msal_cli.job.records import MeshRecord
from msal_cli.version import __version__
from msal_cli.view.illustrations import Pictures

_MAX_BYTES = 64_000_000
"""A larger file is no such archive."""

_NAMES = ("before.jpg", "after.jpg", "deviation.jpg", "scene.html")


def cache_path(report: str) -> str:
    """The archive of a page; a hidden file beside it."""
    folder, name = os.path.split(report)
    return os.path.join(folder, f".{name}.pictures.zip")


class PictureCache:
    """The parts of an archive, and those that are used or added, which are the next archive."""

    def __init__(self, path: str = "") -> None:
        self.n_drawn = 0
        self._old: dict[str, bytes] = {}
        self._new: dict[str, bytes] = {}
        try:
            if path and os.path.getsize(path) <= _MAX_BYTES:
                with zipfile.ZipFile(path) as archive:
                    self._old = {name: archive.read(name) for name in archive.namelist()}
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError):
            self._old = {}

    def find(self, key: str) -> tuple[Pictures, str] | None:
        """The pictures and the scene (empty if there is none) of a key."""
        parts = [self._old.get(f"{key}/{name}", b"") for name in _NAMES]
        if not key or not parts[0]:
            return None
        before, after, deviation, scene = parts
        pictures = Pictures(before, after, deviation or None)
        self._keep(key, pictures, scene)
        return pictures, scene.decode()

    def add(self, key: str, pictures: Pictures, scene: str) -> None:
        """Keep what was drawn."""
        self.n_drawn += 1
        self._keep(key, pictures, scene.encode())

    def _keep(self, key: str, pictures: Pictures, scene: bytes) -> None:
        parts = (pictures.before, pictures.after, pictures.deviation or b"", scene)
        if key:
            self._new |= {f"{key}/{name}": part for name, part in zip(_NAMES, parts, strict=True)}

    def to_bytes(self) -> bytes | None:
        """The archive; None if it is as it was."""
        if self._new == self._old:
            return None
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as archive:
            for name, data in self._new.items():
                # Without the time, the same pictures are the same bytes.
                archive.writestr(zipfile.ZipInfo(name), data)
        return buffer.getvalue()


def picture_key(record: MeshRecord, reach: float, scene: str) -> str:
    """The key of a file's pictures; empty where its bytes are not known.  ``scene`` is the name
    of its scene on the page, or empty."""
    if record.input_sha256 is None or record.output_sha256 is None:
        return ""
    drawn = (__version__, record.input_sha256, record.output_sha256, f"{reach:g}")
    shown = (record.input, scene) if scene else ()
    return hashlib.sha256("\0".join((*drawn, *shown)).encode("utf-8", "replace")).hexdigest()
