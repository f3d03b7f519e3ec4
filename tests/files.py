"""Files in folders: made with any content, and read back."""

from __future__ import annotations

import io
from pathlib import Path


def make_files(folder: Path, *names: str) -> None:
    """Make files with a letter in them, and their folders."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


def tree(folder: Path, has_own: bool = False) -> dict[str, bytes]:
    """All files below a folder by relative name, msal's own only if asked for."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file() and (has_own or not path.name.startswith(".msal-"))
    }


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True
