"""OBJ read in the plainest way, statement by statement, and written: the tests' own idea of it."""

import re
from dataclasses import dataclass, field

_STATEMENT = re.compile(
    rb"[ \t]*(#[^\r\n]*|(?:\\(?:\r\n|\r|\n)|(?<=\s)#[^\r\n]*|[^\r\n])*)(?:\r\n|\r|\n|\Z)"
)
_WORD = re.compile(rb"(?:\\(?![\r\n])|[^\s\\])+")


@dataclass
class Plain:
    """What a file says; ``spans`` are the tokens that may be replaced: (kind, row, start, stop)."""

    vertices: list[list[float]] = field(default_factory=list)
    normals: list[list[float]] = field(default_factory=list)
    polygons: list[list[int]] = field(default_factory=list)
    corner_normals: list[list[int]] = field(default_factory=list)
    spans: list[tuple[str, int, int, int]] = field(default_factory=list)

    def triangles(self) -> list[list[int]]:
        return [[p[0], p[k], p[k + 1]] for p in self.polygons for k in range(1, len(p) - 1)]


def parsed(data: bytes) -> Plain:
    """Read every v, vn and f of a well-formed file."""
    plain = Plain()
    at = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    while at < len(data):
        statement = _STATEMENT.match(data, at)
        assert statement is not None and statement.end() > at
        words = []
        for word in _WORD.finditer(data, statement.start(1), statement.end(1)):
            if word[0].startswith(b"#"):
                break
            words.append(word)
        at = statement.end()
        if words and words[0][0] in (b"v", b"vn"):
            kind = words[0][0].decode()
            rows = plain.vertices if kind == "v" else plain.normals
            plain.spans += [(kind, len(rows), *word.span()) for word in words[1:4]]
            rows.append([float(word[0]) for word in words[1:4]])
        elif words and words[0][0] in (b"f", b"fo") and len(words) > 3:
            corners = [(word[0] + b"//").split(b"/")[:3] for word in words[1:]]
            plain.polygons.append([_index(c[0], len(plain.vertices)) for c in corners])
            plain.corner_normals.append([_index(c[2], len(plain.normals)) for c in corners])
    return plain


def written(vertices, polygons, extra: str = "") -> bytes:
    """A file of positions (n, 3), lines of any kind, and polygons."""
    lines = ["v " + " ".join(map(repr, map(float, row))) for row in vertices]
    lines += [extra] * bool(extra)
    lines += ["f " + " ".join(str(i + 1) for i in row) for row in polygons]
    return "\n".join(lines).encode() + b"\n"


def _index(word: bytes, count: int) -> int:
    number = int(word or b"0")
    return number - 1 if number > 0 else number + count if number < 0 else -1


def blanked(data: bytes, kinds: tuple[str, ...] = ("v", "vn")) -> bytes:
    """The file with every number of a position (and normal) replaced by one sign."""
    pieces, done = [], 0
    for kind, _, start, stop in parsed(data).spans:
        if kind in kinds:
            pieces += [data[done:start], b"@"]
            done = stop
    return b"".join([*pieces, data[done:]])


def tokens(data: bytes, kind: str) -> list[list[bytes]]:
    """The three words of every v or vn."""
    words = [data[a:b] for k, _, a, b in parsed(data).spans if k == kind]
    return [words[k : k + 3] for k in range(0, len(words), 3)]
