"""Fields of data classes that the JSON Schema of the records describes."""

from __future__ import annotations

import dataclasses
from typing import Any


def about(description: str) -> dict[str, str]:
    """The metadata of a field: what the JSON Schema says of it."""
    return {"description": description}


def required(description: str) -> Any:
    """A field that has to be given, with its description."""
    return dataclasses.field(metadata=about(description))


def known(description: str, default: Any = None) -> Any:
    """A field with its description; None, or ``default``, if not known."""
    return dataclasses.field(default=default, metadata=about(description))
