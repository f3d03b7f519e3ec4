"""Bring the pages up to date with the program: shown outputs, and the pages of methods.

    python docs/refresh.py

Every block that follows ``<!-- output: msal ... -->`` is replaced by what that command prints, all
commands that install msal, and the GitLab component, take it from ``SOURCE``, and the pages of
``methods/``, those of the commands and of the Python API, the man pages and the JSON Schemas are
made anew.  A test fails where this was forgotten.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import make_api_page
import make_command_page
import make_man_pages
import make_method_pages
import make_schemas

ROOT = Path(__file__).resolve().parents[1]
SOURCE = " @ https://git.example.com/msal-cli/archive/main.tar.gz"
"""Where pip takes msal from, after its name: an archive of the repository, at a place that stands
for the real one.  Empty once msal is on the package index."""

COMPONENT = ROOT / "templates/denoise.yml"
COMPONENT_SOURCE = re.compile(r"(?<=default: )msal-cli(?: @ \S+)?$", re.MULTILINE)
INSTALL = re.compile(r"pip install '?msal-cli(\[\w+\])?(?: @ [^\s']+)?'?(?![\w-])")
SHOWN = re.compile(r"^<!-- output: msal (.+?) -->\n```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def printed(words: str) -> str:
    """What ``msal`` with these words prints to standard output."""
    command = [sys.executable, "-m", "msal_cli", *shlex.split(words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    return done.stdout.decode().replace("\r\n", "\n")


def refreshed(text: str) -> str:
    """A page with every shown output, and every place to install from, replaced by the real one."""
    return SHOWN.sub(
        lambda block: f"<!-- output: msal {block[1]} -->\n```\n{printed(block[1])}```",
        with_source(text),
    )


def with_source(text: str) -> str:
    """A page whose commands install msal from ``SOURCE``."""
    return INSTALL.sub(lambda command: install_command(command[1] or ""), text)


def install_command(extra: str = "") -> str:
    """The command that installs msal with an extra, such as ``[cloud]``."""
    words = f"msal-cli{extra}{SOURCE}"
    return f"pip install {words}" if words == "msal-cli" else f"pip install '{words}'"


def main() -> None:
    make_api_page.main()
    make_command_page.main()
    make_man_pages.main()
    make_method_pages.main()
    make_schemas.main()
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        if refreshed(text) != text:
            page.write_text(refreshed(text), encoding="utf-8", newline="\n")
            print(f"refreshed {page.relative_to(ROOT)}")
    text = COMPONENT.read_text(encoding="utf-8")
    COMPONENT.write_text(
        COMPONENT_SOURCE.sub(f"msal-cli{SOURCE}", text), encoding="utf-8", newline="\n"
    )


if __name__ == "__main__":
    main()
