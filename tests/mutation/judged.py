"""The survivors that were judged: ``survivors.md``, a line each with the reason."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).with_name("survivors.md")
LINE = re.compile(r"^- `(?P<key>.+?)`: (?P<reason>.+)$")


def read_judged() -> dict[str, str]:
    """The reason for each survivor, by ``target function: what changes``."""
    lines = PAGE.read_text("utf-8").splitlines()
    found = [match for line in lines if (match := LINE.match(line))]
    return {match["key"]: match["reason"] for match in found}
