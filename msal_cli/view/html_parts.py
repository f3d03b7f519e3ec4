"""What pages of HTML are made of: escaped text, inline scripts and styles, and their policy."""

from __future__ import annotations

import base64
import functools
import hashlib
import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from msal_cli.job.display_names import escape_for_display


def escape(text: str) -> str:
    """``text`` as it may be between tags and within quotes."""
    return html.escape(escape_for_display(text), quote=True)


@functools.cache
def asset(module: str, name: str) -> str:
    """The text of a file in the folder ``assets`` beside a module's file."""
    return (Path(module).parent / "assets" / name).read_text(encoding="utf-8")


def to_base64(data: bytes) -> str:
    """``data`` in letters that mean nothing in HTML or JSON."""
    return base64.b64encode(data).decode("ascii")


def content_policy(scripts: Sequence[str], styles: Sequence[str]) -> str:
    """A content security policy, escaped: it allows these inline scripts and styles, pictures in
    the page, and no other.

    Each is the whole text between the tags.
    """
    policy = (
        "default-src 'none'",
        f"script-src {_hashes(scripts)}",
        f"style-src {_hashes(styles)}",
        "img-src data:",
        "base-uri 'none'",
        "form-action 'none'",
    )
    return html.escape("; ".join(policy))


def _hashes(texts: Iterable[str]) -> str:
    hashes = (to_base64(hashlib.sha256(text.encode()).digest()) for text in texts)
    return " ".join(f"'sha256-{one}'" for one in hashes) or "'none'"
