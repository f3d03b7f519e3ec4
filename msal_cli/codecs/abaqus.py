"""Abaqus input files (``.inp``): nodes replaced inside the original bytes.

Read are ``*NODE`` and ``*ELEMENT``, in parts and outside of them; every other keyword is kept
without being looked into.  Files that name further files for their nodes or elements
(``*INCLUDE``, ``INPUT=``) are refused: no other file is ever opened.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.slots import Tokens, line_of
from msal_cli.codecs.surface_cells import SurfaceCells
from msal_cli.codecs.tokens import Words, indices_of
from msal_cli.errors import EXPORT_AGAIN, FormatError, TooLargeError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_MOST_KEYWORDS = 1_000_000
_KEYWORD = re.compile(rb"(?m)^[ \t]*\*[^\r\n]*")
_SURFACE = re.compile(
    r"(?:STRI|DS|SFM3D|M3D|R3D|F3D|AC3D|WARP3D|CPEG|CPE|CPS|CAX|S)(3|4|6|8|9|65)(?![0-9])[A-Z0-9]*$"
)
_LINE = re.compile(r"(?:T2D|T3D|B2|B3|R2D|RB3D|SAX|PIPE)")


@dataclass(eq=False)
class _Part:
    """Nodes and elements that number each other."""

    nodes: list[Words] = field(default_factory=list)
    cells: SurfaceCells = field(default_factory=SurfaceCells)


@dataclass(frozen=True, eq=False)
class _Block:
    """A keyword, its options in capitals, where it stands, and the data below it."""

    keyword: str
    options: dict[str, str]
    at: int
    start: int
    stop: int


def parse(data: Buffer) -> Layout:
    """Read an Abaqus file; UnsupportedError for one that includes others, nodes in another system
    of coordinates or in the plane, and curved elements."""
    from msal_cli.kernels.text import as_bytes

    parts = [_Part()]
    for block in _blocks(data):
        _refuse_references(data, block)
        if block.keyword in ("PART", "INSTANCE", "END PART", "END INSTANCE"):
            parts.append(_Part())
        elif block.keyword == "SYSTEM" or (
            block.keyword == "NODE" and block.options.get("SYSTEM", "R") != "R"
        ):
            raise UnsupportedError(
                "the nodes are given in a system of coordinates of their own",
                where=line_of(data, block.at),
                hint="write the nodes in global rectangular coordinates",
            )
        elif block.keyword == "NODE":
            parts[-1].nodes.append(_words(data, block))
        elif block.keyword == "ELEMENT":
            _read_elements(data, block, parts[-1].cells)
    parts = [part for part in parts if part.nodes]
    if not parts:
        raise FormatError("there is no *NODE", hint="check that it is an Abaqus input file")
    corners, starts, stops = [], [], []
    n_before = 0
    for part in parts:
        tags = []
        for words in part.nodes:
            own, spans = _nodes(words)
            tags.append(own)
            starts.append(spans[0])
            stops.append(spans[1])
        all_tags = np.concatenate(tags)
        corners.append(indices_of(all_tags, part.cells.corners()) + n_before)
        n_before += len(all_tags)
    warnings = [warning for part in parts for warning in part.cells.warnings()]
    if len(parts) > 1:
        warnings.append("parts are denoised where their own nodes are, not where they are placed")
    return Layout(
        "ascii",
        "text",
        (Tokens(as_bytes(data), np.concatenate(starts), np.concatenate(stops)),),
        np.concatenate(corners),
        np.concatenate([part.cells.sizes() for part in parts]),
        properties=(f"{len(parts)} parts",) if len(parts) > 1 else (),
        warnings=tuple(warnings),
        held=", ".join(filter(None, (part.cells.describe() for part in parts))),
    )


def _blocks(data: Buffer) -> Iterator[_Block]:
    """The keywords of a file, comments left out."""
    for count, (one, after) in enumerate(_keyword_lines(data)):
        if count >= _MOST_KEYWORDS:
            raise TooLargeError(
                f"the file has more than {_MOST_KEYWORDS:,} keywords", hint="convert it to PLY"
            )
        line, end = one[0], one.end()
        while line.rstrip().endswith(b","):
            # A keyword line goes on below if it ends with a comma.
            more = re.compile(rb"\r?\n[^\r\n]*").match(data, end)
            if not more or more.end() > after:
                break
            line, end = line + b" " + more[0].strip(), more.end()
        words = line.decode("latin-1").strip()[1:].split(",")
        options = {}
        for word in words[1:]:
            key, _, value = word.partition("=")
            options["".join(key.split()).upper()] = value.strip().upper()
        yield _Block(" ".join(words[0].split()).upper(), options, one.start(), end, after)


def _keyword_lines(data: Buffer) -> Iterator[tuple[re.Match[bytes], int]]:
    """Lines that begin with one asterisk, and where the next of them begins."""
    before = None
    for one in _KEYWORD.finditer(data):
        if one[0].lstrip().startswith(b"**"):
            continue
        if before:
            yield before, one.start()
        before = one
    if before:
        yield before, len(data)


def _refuse_references(data: Buffer, block: _Block) -> None:
    """Raise UnsupportedError for a keyword that takes mesh data from another file."""
    is_include = block.keyword in ("INCLUDE", "MANIFEST")
    if is_include or (block.keyword in ("NODE", "ELEMENT") and "INPUT" in block.options):
        raise UnsupportedError(
            f"*{block.keyword} takes data from another file, which msal does not open",
            where=line_of(data, block.at),
            hint="put the included lines into this file, or export the mesh as one file",
        )


def _words(data: Buffer, block: _Block) -> Words:
    """The words below a keyword; a line that begins with two asterisks is a comment."""
    return Words(data, block.start, block.stop, comment=b"*", blanks=b",")


def _nodes(words: Words) -> tuple[Longs, tuple[Longs, Longs]]:
    """UnitSlots (n,) of nodes, and the spans (3 n,) of their coordinates."""
    first, lengths = words.lines_of_words()
    if len(first) and int(lengths.min()) < 4:
        at = int(first[int(np.argmin(lengths))])
        raise UnsupportedError(
            f"a node has {max(int(lengths.min()) - 1, 0)} coordinates, not three",
            where=words.where(at),
            hint="write three coordinates for each node",
        )
    return words.integers(first), words.row_spans(first + 1, 3)


def _read_elements(data: Buffer, block: _Block, cells: SurfaceCells) -> None:
    kind = block.options.get("TYPE", "")
    words = _words(data, block)
    surface = _SURFACE.match(kind)
    if not surface:
        name = "line" if _LINE.match(kind) else kind or "element"
        cells.count(name, len(words.first_of_lines()))
        return
    corners = surface[1]
    if corners not in ("3", "4"):
        cells.refuse_curved(kind, len(words.first_of_lines()))
        return
    size = int(corners) + 1
    if len(words) % size:
        raise FormatError(
            f"the elements of type {kind} do not have {corners} nodes each",
            where=line_of(data, block.at),
            hint=EXPORT_AGAIN,
        )
    numbers = words.integers(slice(None)).reshape(-1, size)
    cells.add("triangle" if corners == "3" else "quad", numbers[:, 1:])
