"""Numbers of a whole mesh, where only a part of it is there.

A mesh that does not fit into memory is computed part by part.  A part has vertices of its own and
a halo of others around them, as many rings as the method reaches; results are right at the own
ones.  Some numbers belong to the whole mesh: the mean edge length, max sigma of a sweep.  Where a
computation on a part needs one that is not known it raises ``Pending``, which has

- the key of the number,
- what the part contributes to it, for JSON: its own vertices, faces and edges, so that each
  counts once over all parts,
- the state of the computation, named arrays; of some only the own vertices are right, and what the
  others have comes from the parts that own them.

Once ``combine`` has made the number of what all parts contribute, the computation is called again
for each part, with ``known`` that holds it and ``saved`` that is this state, and goes on from there
to the next ``Pending`` or to its end.  All parts need the same numbers in the same order; only
the first ones, before the first state, may come without a state.  A number has the same bits for
any parts, one or a thousand: sums are exact.

    whole = Whole(own_vertices, own_faces)
    while True:
        try:
            result = method.denoise(dataclasses.replace(mesh, whole=whole), parameters)
        except Pending as pending:
            # Send pending.partial, combine what all parts sent, save pending.state, and of its
            # arrays in pending.exchanged replace the rows that other parts own by theirs.
            ...
            whole = dataclasses.replace(
                whole, known={**whole.known, pending.key: number}, saved=state
            )
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats
from msal_cli.kernels.exact_sum import combine_means
from msal_cli.kernels.quantiles import median
from msal_cli.kernels.selection import combine_selections, selection_partial, to_values

State = Mapping[str, NDArray[Any]]
"""Named arrays by which a computation goes on."""


class Pending(Exception):  # noqa: N818 - it is no fault
    """A computation on a part needs a number of the whole mesh that is not known.

    Attributes
    ----------
    key : of the number.
    partial : what this part contributes to it, for JSON.
    state : named arrays, to be given back as ``Whole.saved``; none where there is nothing to save.
    exchanged : names of those, (n, 3) float64, whose rows are right for own vertices only: the rows
        of others have to be replaced by what the parts have that own these.
    """

    def __init__(self, key: str, partial: Any, state: State, exchanged: Sequence[str] = ()) -> None:
        super().__init__(f"{key} of the whole mesh is not known")
        self.key = key
        self.partial = partial
        self.state = dict(state)
        self.exchanged = tuple(exchanged)

    def within(self, whole: Whole, state: State) -> Pending:
        """The same, raised by a step of the computation on ``whole``, with its state as well."""
        outer = {whole.prefix + name: array for name, array in state.items()}
        return Pending(self.key, self.partial, {**outer, **self.state}, self.exchanged)


@dataclass(frozen=True, eq=False)
class Whole:
    """What the computation on a part of a mesh knows of the whole.

    Attributes
    ----------
    own_vertices : (n,) the vertices that this part has and no other.
    own_faces : (m,) the same of faces: those whose first corner in the file is an own vertex.
    known : numbers of the whole mesh by key, as ``combine`` made them: floats, or lists for JSON.
    saved : the state of the last ``Pending``, empty at first.
    prefix : of the keys and names in this computation, which is a step of another; empty mostly.
    positions : of the keys of numbers that follow from positions alone, such as the mean edge
        length: empty for those of the mesh as it was read.
    """

    own_vertices: Flags
    own_faces: Flags
    known: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    saved: State = dataclasses.field(default_factory=dict)
    prefix: str = ""
    positions: str = ""

    def under(self, name: str) -> Whole:
        """The same for a step of that name: its keys and states are apart from all others."""
        return dataclasses.replace(self, prefix=f"{self.prefix}{name}/")

    def moved(self) -> Whole:
        """The same for other positions of the vertices."""
        return dataclasses.replace(self, positions=f"{self.positions}moved ")

    def state(self) -> dict[str, NDArray[Any]]:
        """What this computation has saved, by the names that it gave; empty at its first call."""
        start = len(self.prefix)
        return {
            name[start:]: array
            for name, array in self.saved.items()
            if name.startswith(self.prefix)
        }

    def reduce(
        self,
        key: str,
        partial: Callable[[], Any],
        state: Callable[[], State] = dict,
        exchanged: Sequence[str] = (),
    ) -> Any:
        """The number of that key; ``Pending`` with ``partial()`` and ``state()`` if not known."""
        return self._find(self.prefix + key, partial, state, exchanged)

    def reduce_for_mesh(self, key: str, partial: Callable[[], Any]) -> Any:
        """The same of a number that is one for all steps: it follows from the positions alone."""
        return self._find(self.positions + key, partial, dict, ())

    def _find(
        self,
        name: str,
        partial: Callable[[], Any],
        state: Callable[[], State],
        exchanged: Sequence[str],
    ) -> Any:
        if name in self.known:
            return self.known[name]
        arrays = {self.prefix + one: array for one, array in state().items()}
        raise Pending(name, partial(), arrays, [self.prefix + one for one in exchanged])


def combine(partials: Sequence[Any]) -> Any:
    """The number of the whole mesh from what all of its parts contribute to it, in any order.

    The result is for JSON as well: a float, or a list where more than one round is needed.
    """
    kind = partials[0]["kind"]
    if kind == "largest":
        return max(float(one["value"]) for one in partials)
    return {"mean": combine_means, "selection": combine_selections}[kind](partials)


def largest_of_all(
    whole: Whole, key: str, values: Floats, state: Callable[[], State] = dict
) -> float:
    """The largest of values (n,), not below zero, over the own vertices of all parts."""
    own = whole.own_vertices

    def partial() -> dict[str, Any]:
        return {"kind": "largest", "value": float(values[own].max(initial=0.0))}

    return float(whole.reduce(key, partial, state))


def select_of_all(
    whole: Whole,
    key: str,
    values: Callable[[], Floats],
    wanted: Sequence[tuple[str, float]],
    state: Callable[[], State] = dict,
) -> list[float]:
    """Those of the values (n,) of all parts that would be in certain places if sorted.

    Parameters
    ----------
    values : gives those of this part (k,), each value in one part only; none of them NaN.  It is
        not called where the outcome is known.
    wanted : the places, see ``kernels.selection``.

    Returns one value for each place; none at all where no part has a value.
    """
    found: Any = None
    for number in itertools.count(1):
        contribute = functools.partial(_contribute, values, wanted, found)
        found = whole.reduce(f"{key}, round {number}", contribute, state)
        if found["is_done"]:
            break
    return to_values(found)


def _contribute(
    values: Callable[[], Floats], wanted: Sequence[tuple[str, float]], before: Any
) -> dict[str, Any]:
    return selection_partial(values(), wanted, before)


def quantile_of_all(
    whole: Whole, key: str, values: Floats, share: float, state: Callable[[], State] = dict
) -> float:
    """``quantiles.quantile_above_zero`` of the values (n,), over the own vertices of all parts."""

    def above_zero() -> Floats:
        own = values[whole.own_vertices]
        return own[own > 0.0]

    found = select_of_all(whole, key, above_zero, [("share", share)], state)
    return found[0] if found else 0.0


def median_of_all(
    whole: Whole, key: str, values: Callable[[], Floats], state: Callable[[], State] = dict
) -> float | None:
    """``quantiles.median`` of what ``values()`` (k,) gives in all parts, see ``select_of_all``.

    None where no part has a value.
    """
    found = select_of_all(whole, key, values, [("middle", 0), ("middle", 1)], state)
    if not found:
        return None
    low, high = found
    return low if low == high else (low + high) / 2.0


def median_of_mesh(
    whole: Whole | None,
    key: str,
    values: Callable[[], Floats],
    state: Callable[[], State] = dict,
) -> float | None:
    """``median_of_all``, or for a mesh that is all here (None) the median of ``values()`` (k,)."""
    if whole is not None:
        return median_of_all(whole, key, values, state)
    found = values()
    return median(found) if len(found) else None
