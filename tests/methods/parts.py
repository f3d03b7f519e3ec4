"""A mesh cut into parts, and methods run on each of them round by round."""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.whole import Pending, Whole, combine
from msal_cli.mesh import Mesh


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A part of a mesh: which of its vertices these are, (n,), rising."""

    mesh: Mesh
    vertices: np.ndarray

    @property
    def own(self) -> np.ndarray:
        """The own vertices, by their numbers in the whole mesh."""
        return self.vertices[self.mesh.whole.own_vertices]


def bands(mesh, count):
    """A number of the part, (n,), for each vertex: slabs across the longest axis."""
    axis = np.ptp(mesh.vertices, axis=0).argmax()
    order = np.argsort(np.argsort(mesh.vertices[:, axis], kind="stable"), kind="stable")
    return order * count // len(order)


def widen(faces, chosen, rings):
    """The vertices (n,) within so many rings of those that are chosen."""
    chosen = chosen.copy()
    for _ in range(rings):
        chosen[faces[chosen[faces].any(axis=1)]] = True
    return chosen


def cut(mesh, own, rings):
    """The part with these own vertices (n,) and the rings around."""
    kept = widen(mesh.faces, own, rings)
    vertices = np.flatnonzero(kept)
    number = np.cumsum(kept, dtype=np.int32) - np.int32(1)
    is_inside = kept[mesh.faces].all(axis=1)
    whole = Whole(own[vertices], own[mesh.faces[is_inside, 0]])
    part = Mesh(
        mesh.vertices[vertices],
        np.ascontiguousarray(number[mesh.faces[is_inside]]),
        None if mesh.fixed_vertices is None else mesh.fixed_vertices[vertices],
        None if mesh.trust is None else mesh.trust[vertices],
        whole,
    )
    # Neighbourhoods are those of the faces as they were before some were turned.
    before = number[mesh.topology.faces[is_inside]]
    part.__dict__["topology"] = connectivity(len(vertices), np.ascontiguousarray(before))
    return Part(part, vertices)


def through_json(value):
    return json.loads(json.dumps(value))


def exchange(parts, pending, n):
    """Put the rows that other parts own into the exchanged arrays."""
    for name in pending[0].exchanged:
        rows = np.full((n, 3), np.nan)
        for part, one in zip(parts, pending, strict=True):
            rows[part.own] = one.state[name][part.mesh.whole.own_vertices]
        for part, one in zip(parts, pending, strict=True):
            one.state[name] = rows[part.vertices]


def go_on(part, whole):
    """The part for the next round, of which no more is known than its connectivity."""
    mesh = dataclasses.replace(part.mesh, whole=whole)
    mesh.__dict__["topology"] = part.mesh.topology
    return Part(mesh, part.vertices)


def run_in_parts(method, mesh, parameters, rings, count=3):
    """The positions (n, 3) and fields of all own vertices, and how many rounds it took."""
    labels = bands(mesh, count)
    parts = [cut(mesh, labels == one, rings) for one in range(count)]
    known, rounds = {}, 0
    while True:
        rounds += 1
        results, pending = [], []
        for part in parts:
            try:
                results.append(method.denoise(part.mesh, parameters))
            except Pending as one:
                pending.append(one)
        if not pending:
            break
        assert not results
        assert len({one.key for one in pending}) == 1
        known[pending[0].key] = through_json(
            combine([through_json(one.partial) for one in pending])
        )
        exchange(parts, pending, len(mesh.vertices))
        parts = [
            go_on(part, dataclasses.replace(part.mesh.whole, known=known, saved=one.state))
            for part, one in zip(parts, pending, strict=True)
        ]
    vertices = np.full_like(mesh.vertices, np.nan)
    fields = {name: np.full(len(vertices), np.nan) for name in results[0].fields}
    for part, result in zip(parts, results, strict=True):
        own = part.mesh.whole.own_vertices
        vertices[part.own] = result.vertices[own]
        for name, values in result.fields.items():
            fields[name][part.own] = values[own]
    return vertices, fields, rounds
