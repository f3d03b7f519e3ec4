"""Check a built site: every link inside it, and that it needs nothing from elsewhere.

    python docs/check_site.py site

Links to other hosts are counted by host and not followed.  Exit status 1 if anything is wrong.
"""

from __future__ import annotations

import sys
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# These make the browser load what they name.
_LOADED = {"script": "src", "img": "src", "source": "src", "iframe": "src", "link": "href"}


class Page(HTMLParser):
    """What a page links to, loads, and offers as targets of links."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.without_alt: list[str] = []
        self.title = ""
        self._in_title = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.ids.update(given[name] for name in ("id", "name") if given.get(name))
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif _LOADED.get(tag, "") in given:
            self.loaded.append(given[_LOADED[tag]])
        if tag == "img" and not given.get("alt", "").strip():
            self.without_alt.append(given.get("src", ""))
        # Pictures in SVG have titles of their own.
        self._in_title = tag == "title" and not self.title

    def handle_data(self, data: str) -> None:
        if self._in_title:
            self.title += data

    def handle_endtag(self, tag: str) -> None:
        self._in_title = False


def problems(site: Path) -> tuple[list[str], Counter[str]]:
    """What is wrong with a site, and how many links lead to each other host."""
    site = site.resolve()
    pages = {path: Page(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}
    wrong: list[str] = []
    hosts: Counter[str] = Counter()
    titles = Counter(page.title for page in pages.values())
    for path, page in pages.items():
        name = path.relative_to(site).as_posix()
        if not page.title.strip() or titles[page.title] > 1:
            wrong.append(f"{name}: the title {page.title!r} is empty or that of another page, too")
        wrong += [f"{name}: {source} has no alt text" for source in page.without_alt]
        for target in page.loaded:
            if urlsplit(target).netloc or target.startswith("//"):
                wrong.append(f"{name}: loads {target} from another host")
        for target in (*page.links, *page.loaded):
            parts = urlsplit(target)
            if parts.netloc:
                hosts[parts.netloc] += 1
            elif parts.scheme in ("", "file"):
                there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                if not there.is_relative_to(site) or not there.is_file():
                    wrong.append(f"{name}: {target} leads nowhere")
                elif there in pages and not _has_anchor(pages[there], parts.fragment):
                    wrong.append(f"{name}: {target} has no such anchor")
    if not pages:
        wrong.append(f"{site} has no page")
    return wrong, hosts


def _has_anchor(page: Page, fragment: str) -> bool:
    return not fragment or unquote(fragment) in page.ids


def main() -> int:
    wrong, hosts = problems(Path(sys.argv[1]))
    for line in wrong:
        print(line, file=sys.stderr)
    for host, count in sorted(hosts.items()):
        print(f"{count:5} links to {host}, not followed")
    print(f"{len(wrong)} problems")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
