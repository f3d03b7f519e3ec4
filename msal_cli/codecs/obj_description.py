"""What else stands in an OBJ file, in words for reports: properties, references, warnings."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from msal_cli.arrays import Longs
from msal_cli.storage.buffers import Buffer

Keywords = Mapping[bytes, tuple[int, int]]
"""Keywords other than v, vt, vn and f: how often each occurs, and where first.  Of the walk's
``state``, see ``kernels.obj_scan``, only counts are looked at."""

_PROPERTY_OF = {
    b"usemtl": "materials",
    b"usemap": "texture maps",
    b"g": "groups",
    b"mg": "merging groups",
    b"o": "objects",
    b"s": "smoothing groups",
    b"l": "lines (vertices that only they use stay in place)",
    b"p": "points (vertices that only they use stay in place)",
}
_FREE_FORM = frozenset(
    b"vp cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con"
    b" bzp bsp cdc cdp res".split()
)
_DISPLAY = frozenset(
    b"bevel c_interp d_interp lod maplib shadow_obj trace_obj ctech stech mtllib call csh".split()
)

_CONTINUED = re.compile(rb"\\(\r\n|\r|\n)")
_LIBRARY = re.compile(r"\S.*?\.mtl(?=\s|$)|\S.*", re.IGNORECASE)
_SHOWN = 3


def properties(state: Longs, keywords: Keywords) -> tuple[str, ...]:
    """What is carried along beside positions and faces."""
    from msal_cli.kernels import obj_scan

    found = []
    if state[obj_scan.TEXTURE]:
        found.append("texture coordinates")
    if state[obj_scan.NORMALS]:
        found.append("normals")
    if state[obj_scan.COLOURED]:
        found.append("vertex colours")
    if state[obj_scan.WEIGHTED]:
        found.append("weights w")
    found += [words for keyword, words in _PROPERTY_OF.items() if keyword in keywords]
    if not _FREE_FORM.isdisjoint(keywords):
        found.append("free-form geometry (vertices that only it uses stay in place)")
    return tuple(found)


def references(data: Buffer, libraries: Longs) -> tuple[str, ...]:
    """The material libraries that ``mtllib`` statements at these bytes name, in order, each once.

    A name may hold blanks: it ends with ``.mtl``, or with the line.
    """
    names: dict[str, None] = {}
    view = memoryview(data)
    for at in libraries:
        for name in _LIBRARY.findall(_argument(view, int(at), b"mtllib")):
            names[name.strip().strip('"')] = None
    return tuple(name for name in names if name)


def _argument(view: memoryview, at: int, keyword: bytes) -> str:
    """What stands behind the keyword at ``at``, continued lines joined."""
    size = 1 << 10
    while True:
        text = _CONTINUED.sub(b" ", bytes(view[at : at + size]))
        line = re.match(rb"[^\r\n]*", text)
        assert line is not None
        # A backslash in the last bytes looked at may continue the line.
        if at + size >= len(view) or line.end() < len(text) - 1:
            break
        size *= 2
    return line[0][len(keyword) :].decode("utf-8", "surrogateescape").strip()


def warnings(state: Longs, keywords: Keywords, line_at: Callable[[int], int]) -> tuple[str, ...]:
    """What a user should know of a file that could be read all the same; ``line_at`` is the line of
    a byte."""
    from msal_cli.kernels import obj_scan

    found = []
    if state[obj_scan.WEIGHTED]:
        line = line_at(int(state[obj_scan.WEIGHTED_AT]))
        found.append(
            f"{_counted(state[obj_scan.WEIGHTED], 'vertex has', 'vertices have')} a weight w other"
            f" than 1 (first in line {line}); x y z are taken as they stand and w is kept"
        )
    if state[obj_scan.SHORT]:
        line = line_at(int(state[obj_scan.SHORT_AT]))
        found.append(
            f"{_counted(state[obj_scan.SHORT], 'face has', 'faces have')} fewer than three corners"
            f" (first in line {line}); kept in the file, left out of the computation"
        )
    for number, count, what in (
        (state[obj_scan.LARGEST_TEXTURE], state[obj_scan.TEXTURE], "texture coordinate"),
        (state[obj_scan.LARGEST_NORMAL], state[obj_scan.NORMALS], "normal"),
    ):
        if number > count:
            found.append(f"faces name {what} {number}, but there are {count}; kept as they are")
    if state[obj_scan.BEFORE_FIRST]:
        found.append(
            "faces name a texture coordinate or normal 0, or one before the first"
            f" ({_counted(state[obj_scan.BEFORE_FIRST], 'corner', 'corners')}); kept as they are"
        )
    unknown = {
        keyword: seen
        for keyword, seen in keywords.items()
        if keyword not in _PROPERTY_OF and keyword not in _FREE_FORM | _DISPLAY
    }
    if unknown:
        shown = ", ".join(
            f"{keyword[:20].decode('utf-8', 'backslashreplace')!r} in line {line_at(at)}"
            for keyword, (_, at) in list(unknown.items())[:_SHOWN]
        )
        total = sum(count for count, _ in unknown.values())
        found.append(
            f"{_counted(total, 'line is', 'lines are')} no statement that is known and kept as"
            f" {'it is' if total == 1 else 'they are'}: {shown}{', ...' * (len(unknown) > _SHOWN)}"
        )
    return tuple(found)


def misfit_warning(
    n_normals: int, n_before: int, n_after: int, n_faces: int, limit_deg: float
) -> str:
    """What to say where ``n_after`` of all faces are further than a limit from a ``vn`` that they
    share, and fewer of them were before."""
    before, after = (f"{100.0 * one / n_faces:.1f} %" for one in (n_before, n_after))
    return (
        f"{_counted(n_normals, 'vn is', 'vn are')} shared by faces that turned apart: {n_after} of"
        f" {n_faces} faces ({after}) are now more than {limit_deg:.0f} degrees off their vn"
        f" ({before} before); let the program that reads the file compute normals, or write PLY"
        " (--to ply), which has one for each vertex"
    )


def _counted(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"
