"""Check that a tag may be released, and write its notes.

    python packaging/check_release.py v1.2.3 [-o notes.md]

The version is written once, as ``__version__`` of the package, so that an archive without the
history has it too.  The tag must be ``v`` and that version, and ``docs/changelog.md`` must have a
section with that heading, which becomes the notes.  Needs the standard library only.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSION = re.compile(r'^__version__ = "([^"]+)"$', re.MULTILINE)


def read_version(root: Path) -> str:
    """The version of the package in a checkout, without importing it."""
    found = VERSION.search((root / "msal_cli/version.py").read_text(encoding="utf-8"))
    if found is None:
        raise SystemExit('msal_cli/version.py: no line __version__ = "..."')
    return found[1]


def read_section(changelog: str, version: str) -> str | None:
    """The text under ``## VERSION`` (a date may follow), or None where there is no such heading."""
    heading = re.compile(rf"^## {re.escape(version)}(?:[ \t].*)?$", re.MULTILINE)
    found = heading.search(changelog)
    if found is None:
        return None
    rest = changelog[found.end() :]
    following = re.search(r"^## ", rest, re.MULTILINE)
    return rest[: following.start() if following else None].strip()


def find_faults(root: Path, tag: str) -> list[str]:
    """Why the checkout cannot be released as this tag."""
    version = read_version(root)
    faults = []
    if tag != f"v{version}":
        faults.append(f"the tag is {tag}, and msal_cli/version.py says {version}: tag v{version}")
    section = read_section((root / "docs/changelog.md").read_text(encoding="utf-8"), version)
    if section is None:
        faults.append(f"docs/changelog.md has no section '## {version}': rename '## Unreleased'")
    elif not section:
        faults.append(f"docs/changelog.md: the section '## {version}' is empty")
    return faults


def main(words: list[str] | None = None) -> None:
    """Check a tag; the exit status is 1 where it is at fault."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tag")
    parser.add_argument("-o", dest="notes", type=Path, help="where to write the notes")
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout")
    arguments = parser.parse_args(words)
    faults = find_faults(arguments.root, arguments.tag)
    if faults:
        raise SystemExit("\n".join(faults))
    changelog = (arguments.root / "docs/changelog.md").read_text(encoding="utf-8")
    notes = read_section(changelog, read_version(arguments.root))
    if arguments.notes:
        arguments.notes.write_text(f"{notes}\n", encoding="utf-8", newline="\n")
    else:
        sys.stdout.write(f"{notes}\n")


if __name__ == "__main__":
    main()
