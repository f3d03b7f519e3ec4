"""The site of these pages: ``sphinx-build -W docs site`` with the extra ``docs``.

The pages are plain Markdown that any viewer shows.  What a site needs beside them is added here
while it is built: the navigation, from the lists of index.md; the programs of the gallery under
their table; and links to files outside this folder.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

from docutils import nodes

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent

project = "msal"
author = "the authors of msal"
release = re.findall(r'__version__ = "(.+)"', (ROOT / "msal_cli/version.py").read_text("utf-8"))[0]
extensions = ["myst_parser"]
exclude_patterns = ["images"]
# As code hosts do, for links to headings.
myst_heading_anchors = 4
highlight_language = "none"
# It would make a dash of the two before an option.
smartquotes = False

html_theme = "furo"
html_title = f"msal {release}"
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_use_index = False
html_static_path = ["site"]
html_css_files = ["site.css"]

REPOSITORY = os.environ.get("MSAL_REPOSITORY", "")
"""Where links to files outside docs/ lead, such as https://HOST/OWNER/NAME/blob/main.  Where it is
empty, the site has copies of these files to download."""

_LINK = re.compile(r"\]\(([^)\s:#]+)(#[^)\s]*)?\)")


def toctrees(index: str) -> str:
    """The navigation: one group for each heading of the first page that has a list of pages."""
    groups = []
    for section in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        title, _, body = section.partition("\n")
        pages = re.findall(r"^- \[[^]]*\]\(([^)#]+)\.md\)", body, re.MULTILINE)
        if pages:
            groups.append(toctree(pages, caption=title))
    return "\n".join(groups)


def toctree(pages: list[str], **options: str) -> str:
    """A list of pages that only the navigation shows."""
    shown = "".join(f":{name}: {value}\n" for name, value in options.items())
    return "\n```{toctree}\n:hidden:\n" + shown + "\n" + "\n".join(pages) + "\n```\n"


def gallery(page: str) -> str:
    """The programs and notebooks of the gallery as text, in the order of its table."""
    parts = []
    for name in re.findall(r"\]\((\w+\.(?:py|ipynb))\)", page):
        text = (DOCS / "examples" / name).read_text("utf-8")
        parts.append(f"## {name}\n")
        parts.append(notebook(text) if name.endswith(".ipynb") else f"```python\n{text}```\n")
    return "\n" + "\n".join(parts)


def notebook(text: str) -> str:
    """The cells of a notebook as Markdown; its headings are below those of the page."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        is_code = cell["cell_type"] == "code"
        parts.append(f"```python\n{source}\n```" if is_code else re.sub("^#", "###", source))
    return "\n\n".join(parts) + "\n"


def with_outside_links(text: str, page: Path) -> str:
    """A page whose links to files outside docs/ lead to the repository, or to copies of them."""

    def replace(link: re.Match[str]) -> str:
        target = (page.parent / link[1]).resolve()
        if target.is_relative_to(DOCS) or not target.is_file():
            return link[0]
        if REPOSITORY:
            return f"]({REPOSITORY}/{target.relative_to(ROOT).as_posix()}{link[2] or ''})"
        # MyST's word for a file to download, which it would else take for a page.
        return f"](path:{link[1]})"

    return _LINK.sub(replace, text)


def complete(app: Any, name: str, source: list[str]) -> None:
    """Add to a page what it has on the site only."""
    text = with_outside_links(source[0], DOCS / f"{name}.md")
    # A link that shows a file's name shows the title of the page here.
    text = re.sub(r"\[[\w./-]+\.md\](?=\((?!path:)[^:)]+\))", "[]", text)
    if name == "index":
        text += toctrees(text)
    elif name == "methods/README":
        text += toctree(["*"], glob="")
    elif name == "examples/README":
        text += gallery(text)
    source[0] = text


def mark(app: Any, doctree: nodes.document) -> None:
    """Give short code and long cells classes, for the style sheet."""
    for code in doctree.findall(nodes.literal):
        if len(code.astext()) <= 30:
            code["classes"].append("short")
    for cell in doctree.findall(nodes.entry):
        if len(cell.astext()) > 60:
            cell["classes"].append("long")


def setup(app: Any) -> None:
    """Register with Sphinx."""
    app.connect("source-read", complete)
    app.connect("doctree-read", mark)
