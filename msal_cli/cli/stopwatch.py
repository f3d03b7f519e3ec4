"""When a command began and how long it has taken."""

from __future__ import annotations

import time
from datetime import UTC, datetime


class Clock:
    """Started when it is made; ``started`` is UTC, ISO 8601, to the millisecond."""

    def __init__(self) -> None:
        self.started = self.now()
        self._start = time.perf_counter()

    @staticmethod
    def now() -> str:
        """The time in the form of ``started``."""
        return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")

    def seconds(self) -> float:
        """Wall-clock seconds since the start, by a clock that nobody sets."""
        return time.perf_counter() - self._start
