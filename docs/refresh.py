"""Bring the pages up to date with the program: shown outputs, and the page of methods.

    python docs/refresh.py

Every block that follows ``<!-- output: msal ... -->`` is replaced by what that command prints.
``methods.md`` gets one such block for each method.  A test fails where this was forgotten.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

from msal_cli import methods

ROOT = Path(__file__).resolve().parents[1]
SHOWN = re.compile(r"^<!-- output: msal (.+?) -->\n```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL)

METHODS_HEAD = """# Methods

What `msal methods NAME` prints, for every method. [algorithm.md](algorithm.md) has the formulas of
`al` and `msal` in full, and tells which setting to choose.
"""


def printed(words: str) -> str:
    """What ``msal`` with these words prints to standard output."""
    command = [sys.executable, "-m", "msal_cli", *shlex.split(words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    return done.stdout.decode().replace("\r\n", "\n")


def methods_page() -> str:
    """The page of methods, its blocks still empty."""
    sections = [
        f"\n## {name}\n\n<!-- output: msal methods {name} -->\n```\n```\n"
        for name in methods.names()
    ]
    return METHODS_HEAD + "".join(sections)


def refreshed(text: str) -> str:
    """A page with every shown output replaced by the real one."""
    return SHOWN.sub(
        lambda block: f"<!-- output: msal {block[1]} -->\n```\n{printed(block[1])}```", text
    )


def main() -> None:
    (ROOT / "docs/methods.md").write_text(methods_page(), encoding="utf-8")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        if refreshed(text) != text:
            page.write_text(refreshed(text), encoding="utf-8", newline="\n")
            print(f"refreshed {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
