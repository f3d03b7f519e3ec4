"""The values at certain places of the sorted values of many parts, in rounds of bounded messages.

Every float64 has a number of 64 bits that rises with it.  The first round counts the numbers by
their leading bits, each further one those that share the leading bits of the value looked for, by
the next bits; once few are left they are sent themselves.  So the value is found exactly, and no
message grows with the mesh.

A place is ``("share", q)``: the least value that at least the share q of all do not exceed; or
``("middle", 0)`` and ``("middle", 1)``: the lower and the upper one of the middle two, which are
the same where the count is odd.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats

FIRST_BITS, NEXT_BITS = 16, 12
"""Bits that the first round counts by, and each further one."""

FEW = 4096
"""Values that are sent themselves, at most, by all parts together."""

_TOP = np.uint64(1) << np.uint64(63)

Place = dict[str, Any]
"""Where a value is: its ``leading`` bits, how many these are, its rank among the ``count`` values
that have them; and ``number``, once it is known."""


def _to_numbers(values: Floats) -> NDArray[np.uint64]:
    """Numbers of 64 bits in the order of the values."""
    bits = np.ascontiguousarray(values).view(np.uint64)
    return np.where(bits & _TOP, ~bits, bits | _TOP)


def _to_value(number: int) -> float:
    bits = number & ~(1 << 63) if number >> 63 else number ^ 0xFFFFFFFFFFFFFFFF
    return float(np.array([bits], dtype=np.uint64).view(np.float64)[0])


def selection_partial(
    values: Floats, wanted: Sequence[tuple[str, float]], before: dict[str, Any] | None
) -> dict[str, Any]:
    """What a part contributes to a round; ``before`` is what the round before has found."""
    numbers = _to_numbers(values)
    if before is None:
        counts = _count(numbers >> np.uint64(64 - FIRST_BITS))
        return {"kind": "selection", "wanted": [list(one) for one in wanted], "counts": counts}
    parts = [_places_partial(numbers, place) for place in before["places"]]
    return {"kind": "selection", "before": before["places"], "parts": parts}


def _places_partial(numbers: NDArray[np.uint64], place: Place) -> list[Any]:
    if "number" in place:
        return []
    bits = place["bits"]
    alike = numbers[numbers >> np.uint64(64 - bits) == np.uint64(place["leading"])]
    if place["count"] <= FEW:
        return [int(one) for one in np.sort(alike)]
    return _count(_next_bits(alike, bits))


def _next_bits(numbers: NDArray[np.uint64], bits: int) -> NDArray[np.uint64]:
    more = min(NEXT_BITS, 64 - bits)
    return (numbers >> np.uint64(64 - bits - more)) & np.uint64((1 << more) - 1)


def _count(keys: NDArray[np.uint64]) -> list[list[int]]:
    """Pairs of a key and how many have it."""
    found, counts = np.unique(keys, return_counts=True)
    return [[int(key), int(count)] for key, count in zip(found, counts, strict=True)]


def combine_selections(partials: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What a round has found: ``places``, and whether all of their values are known."""
    first = partials[0]
    if "wanted" in first:
        counts = _add_counts([one["counts"] for one in partials])
        total = sum(counts.values())
        places = []
        for kind, which in first["wanted"] if total else []:
            rank = math.ceil(which * total) - 1 if kind == "share" else (total - 1 + which) // 2
            places.append(_narrow({"leading": 0, "bits": 0, "rank": int(rank)}, counts, FIRST_BITS))
    else:
        places = [
            _narrow_further(place, [one["parts"][at] for one in partials])
            for at, place in enumerate(first["before"])
        ]
    return {"places": places, "is_done": all("number" in one for one in places)}


def _narrow_further(place: Place, parts: list[list[Any]]) -> Place:
    if "number" in place:
        return place
    if place["count"] <= FEW:
        numbers = sorted(number for part in parts for number in part)
        return {"number": numbers[place["rank"]]}
    return _narrow(place, _add_counts(parts), min(NEXT_BITS, 64 - place["bits"]))


def _add_counts(parts: list[list[list[int]]]) -> dict[int, int]:
    counts: dict[int, int] = {}
    for part in parts:
        for key, count in part:
            counts[key] = counts.get(key, 0) + count
    return counts


def _narrow(place: Place, counts: dict[int, int], more: int) -> Place:
    """The place among those that share the next ``more`` bits with the value."""
    rank = place["rank"]
    for key in sorted(counts):
        if rank < counts[key]:
            leading, bits = place["leading"] << more | key, place["bits"] + more
            if bits == 64:
                return {"number": leading}
            return {"leading": leading, "bits": bits, "rank": rank, "count": counts[key]}
        rank -= counts[key]
    raise AssertionError("the parts of a selection do not fit together")


def to_values(found: dict[str, Any]) -> list[float]:
    """The values at the places that were wanted; none at all where no part has a value."""
    return [_to_value(one["number"]) for one in found["places"]]
