"""What the HTML report shows beside the records: pictures and scenes, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Pictures:
    """JPEGs of one mesh from one place: before, after, and where it moved (None: not known)."""

    before: bytes
    after: bytes
    deviation: bytes | None = None


@dataclass(frozen=True)
class Scale:
    """What the colours of all deviations mean: hex colours from ``low`` to ``high``."""

    title: str
    low: str
    high: str
    colours: tuple[str, ...]


@dataclass(frozen=True)
class Gallery:
    """Pictures and scenes by the number of the record, as far as there are any.

    ``scenes`` are elements of HTML, which ``script`` (behind them) and ``style`` bring to life.
    ``remarks`` say in words what was left out, and why.
    """

    pictures: Mapping[int, Pictures] = field(default_factory=dict)
    scenes: Mapping[int, str] = field(default_factory=dict)
    scale: Scale | None = None
    script: str = ""
    style: str = ""
    remarks: tuple[str, ...] = ()


EMPTY = Gallery()
