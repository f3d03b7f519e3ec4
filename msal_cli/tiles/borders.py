"""Connected parts of a mesh from those of its tiles, joined over the triangles that tiles share.

In the folder of a tile, ``links.npy`` (k, 2) has the number of each shared triangle and that of the
tile's part with it.  The parts of a tile are numbered from 0 on, those with shared triangles first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis.enclosure import MOST_PARTS
from msal_cli.kernels.components import component_labels
from msal_cli.kernels.halos import shared_faces
from msal_cli.tiles.part_files import TileMesh, load_array, save_array

if TYPE_CHECKING:
    from pathlib import Path

    from msal_cli.arrays import Ints

_LINKS, _NUMBERS = "links.npy", "part_numbers.npy"


def save_links(folder: Path, mesh: TileMesh) -> dict[str, int]:
    """Write which part of the tile each triangle belongs to that other tiles have too.

    Returns how many parts have such triangles, ``open``, and how many have none, ``closed``.
    """
    labels = component_labels(len(mesh.vertices), mesh.faces)
    shared, open_labels, closed_labels = _find_parts(mesh, labels)
    parts = np.searchsorted(open_labels, labels[mesh.faces[shared, 0]])
    save_array(folder / _LINKS, np.stack([mesh.triangles[shared], parts.astype(np.uint32)], axis=1))
    return {"open": len(open_labels), "closed": len(closed_labels)}


def join_parts(folders: list[Path], counts: list[dict[str, int]]) -> int:
    """How many connected parts the whole mesh has; ``counts`` are those of ``save_links``.

    If they are not too many, each tile gets the numbers of its parts among those of the whole.
    """
    n_open = np.cumsum([0] + [count["open"] for count in counts])
    pairs = []
    for folder, start in zip(folders, n_open[:-1], strict=True):
        links = load_array(folder / _LINKS).astype(np.int64)
        links[:, 1] += start
        pairs.append(links)
    links = np.concatenate(pairs)
    links = links[np.argsort(links[:, 0], kind="stable")]
    same = links[1:, 0] == links[:-1, 0]
    one, other = links[:-1, 1][same], links[1:, 1][same]
    joins = np.stack([one, other, other], axis=1).astype(np.int32)
    found, numbers = np.unique(component_labels(int(n_open[-1]), joins), return_inverse=True)
    total = len(found) + sum(count["closed"] for count in counts)
    if total <= MOST_PARTS:
        n_closed = len(found)
        for folder, start, count in zip(folders, n_open[:-1], counts, strict=True):
            closed = np.arange(n_closed, n_closed + count["closed"])
            own = numbers[start : start + count["open"]]
            save_array(folder / _NUMBERS, np.concatenate([own, closed]).astype(np.int32))
            n_closed += count["closed"]
    return total


def number_parts(folder: Path, mesh: TileMesh) -> Ints:
    """For each own vertex of a tile, and others connected to it, the number of its part among those
    of the whole mesh, (n,); anything for others."""
    labels = component_labels(len(mesh.vertices), mesh.faces)
    _, open_labels, closed_labels = _find_parts(mesh, labels)
    numbers = np.zeros(len(labels), dtype=np.int32)
    numbers[np.concatenate([open_labels, closed_labels])] = load_array(folder / _NUMBERS)
    parts: Ints = numbers[labels]
    return parts


def _find_parts(mesh: TileMesh, labels: Ints) -> tuple[Ints, Ints, Ints]:
    """The shared faces of a tile, and the labels of its parts with such and without."""
    shared = shared_faces(mesh.faces, mesh.own_vertices)
    is_open = np.zeros(len(labels), dtype=bool)
    is_open[labels[mesh.faces[shared, 0]]] = True
    is_closed = np.zeros(len(labels), dtype=bool)
    is_closed[labels[mesh.own_vertices]] = True
    is_closed &= ~is_open
    open_labels, closed_labels = np.flatnonzero(is_open), np.flatnonzero(is_closed)
    return shared, open_labels.astype(np.int32), closed_labels.astype(np.int32)
