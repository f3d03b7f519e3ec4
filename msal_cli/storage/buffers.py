"""The bytes of a file in memory, whatever holds them."""

from __future__ import annotations

Buffer = bytes | bytearray | memoryview
