"""Bring the pages up to date with the program: shown outputs, and the pages of methods.

    python docs/refresh.py

Every block that follows ``<!-- output: msal ... -->`` is replaced by what that command prints, all
commands that install msal, the pieces for CI and the GitLab component take it from ``REPOSITORY``,
and the pages of ``methods/``, those of the commands and of the Python API, the man pages and the
JSON Schemas are made anew.  A test fails where this was forgotten.
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
REPOSITORY = ""
"""The address of the repository, such as https://HOST/OWNER/msal-cli: the one place to set it.
Empty while it has none: pages then show ``PLACEHOLDER`` and say that it is one, and the GitLab
component has no default to install from."""

ARCHIVE = "archive/main.tar.gz"
"""Where an archive of the branch main is below that address; on GitLab
-/archive/main/msal-cli-main.tar.gz."""

IS_ON_INDEX = False
"""Whether pip takes msal from the package index instead."""

PLACEHOLDER = "https://git.example.com/OWNER/msal-cli"
NOTE = (
    "The repository has no public address yet: put that of your copy in place of "
    "`https://git.example.com/OWNER`, where nothing answers."
)

PAGES = (
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "docs/example_repository/.github/workflows/meshes.yml",
)
COMPONENT = ROOT / "templates/denoise.yml"
COMPONENT_SOURCE = re.compile(r"(    source:\n      description: .*\n)(?:      default: .*\n)?")
INSTALL = re.compile(r"pip install '?msal-cli(\[\w+\])?(?: @ [^\s']+)?'?(?![\w-])")
# The pieces of docs/ci.md and the example repository.
ADDRESSES = (
    (re.compile(r"(?<=- component: )\S+(?=/denoise@main)"), lambda: address().split("://")[1]),
    (re.compile(r"(?<=- repo: )https:\S+"), lambda: address()),
    (re.compile(r"(?<=uses: )[\w.-]+/msal-cli(?=@main)"), lambda: address().split("/", 3)[3]),
    (re.compile(r"(?<=source: )msal-cli @ \S+"), lambda: f"msal-cli{source()}"),
    (
        re.compile(r"^.*(?=<!-- address -->$)", re.MULTILINE),
        lambda: "" if REPOSITORY else f"{NOTE} ",
    ),
)
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


def address() -> str:
    """The address of the repository, or the placeholder."""
    return REPOSITORY or PLACEHOLDER


def source() -> str:
    """Where pip takes msal from, after its name; empty for the package index."""
    return "" if IS_ON_INDEX else f" @ {address()}/{ARCHIVE}"


def with_source(text: str) -> str:
    """A page with the address of the repository, whose commands install msal from there."""
    text = INSTALL.sub(lambda command: install_command(command[1] or ""), text)
    for place, find_value in ADDRESSES:
        text = place.sub(find_value(), text)
    return text


def component_with_source(text: str) -> str:
    """The GitLab component, which installs msal from the repository if its address is known."""
    is_known = bool(REPOSITORY) or IS_ON_INDEX
    default = f"      default: msal-cli{source()}\n" if is_known else ""
    return COMPONENT_SOURCE.sub(lambda found: found[1] + default, text)


def install_command(extra: str = "") -> str:
    """The command that installs msal with an extra, such as ``[cloud]``."""
    words = f"msal-cli{extra}{source()}"
    return f"pip install {words}" if words == "msal-cli" else f"pip install '{words}'"


def main() -> None:
    make_api_page.main()
    make_command_page.main()
    make_man_pages.main()
    make_method_pages.main()
    make_schemas.main()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        if refreshed(text) != text:
            page.write_text(refreshed(text), encoding="utf-8", newline="\n")
            print(f"refreshed {page.relative_to(ROOT)}")
    text = component_with_source(COMPONENT.read_text(encoding="utf-8"))
    COMPONENT.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
