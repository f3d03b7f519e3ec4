"""HTML pages taken apart, and held to loading and running nothing but their own."""

import base64
import hashlib
from html.parser import HTMLParser

VOID = {"meta", "link", "input", "br", "img"}


class Page(HTMLParser):
    """Tags with attributes, the texts of each kind of element and of each id; all is closed."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts, self.ids, self.within = [], {}, {}, []
        self.feed(text)
        self.close()
        assert self.within == []

    def handle_starttag(self, tag, attributes):
        self.handle_startendtag(tag, attributes)
        if tag not in VOID:
            self.within.append((tag, dict(attributes).get("id")))
            self.texts.setdefault(tag, []).append("")

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.within.pop()[0] == tag

    def handle_data(self, data):
        if self.within:
            tag, key = self.within[-1]
            self.texts[tag][-1] += data
            self.ids[key] = self.ids.get(key, "") + data

    def attributes(self, tag):
        return [found for name, found in self.tags if name == tag]


def assert_self_contained(page):
    """The policy allows the page's own styles and scripts, by digests; nothing is elsewhere."""
    (policy,) = [found["content"] for found in page.attributes("meta") if "http-equiv" in found]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    scripts = zip(page.attributes("script"), page.texts["script"], strict=True)
    code = [text for attributes, text in scripts if "type" not in attributes]
    for rule, texts in (("style-src", page.texts["style"]), ("script-src", code)):
        digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()) for text in texts]
        assert set(rules[rule].split()) == {f"'sha256-{digest.decode()}'" for digest in digests}
    assert "unsafe" not in policy and "http:" not in policy and "*" not in policy
    for _, attributes in page.tags:
        for key in ("src", "href", "action", "srcset"):
            assert (attributes.get(key) or "data:").startswith("data:")
        assert not any(key.startswith("on") or key == "style" for key in attributes)
