"""Connected parts of a mesh from those of its tiles, joined over the triangles that tiles share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msal_cli.kernels.components import component_labels, count_components
from msal_cli.kernels.halos import shared_faces
from msal_cli.tiles.part_files import TileMesh, load_array

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_LINKS = "links.npy"


def save_links(folder: Path, mesh: TileMesh) -> dict[str, int]:
    """Write which connected part of the tile each triangle belongs to that other tiles have too.

    Returns how many parts of the tile's own have no such triangle, ``closed``, and how many have,
    ``open``.
    """
    labels = component_labels(len(mesh.vertices), mesh.faces)
    shared = shared_faces(mesh.faces, mesh.own_vertices)
    open_labels, numbers = np.unique(labels[mesh.faces[shared, 0]], return_inverse=True)
    is_own = np.zeros(len(labels), dtype=bool)
    is_own[labels[mesh.own_vertices]] = True
    links = np.stack([mesh.triangles[shared], numbers.astype(np.uint32)], axis=1)
    np.save(folder / _LINKS, links)
    n_own = int(np.count_nonzero(is_own))
    return {"closed": n_own - len(open_labels), "open": len(open_labels)}


def join_parts(folders: Iterable[Path], counts: Iterable[dict[str, int]]) -> int:
    """How many connected parts the whole mesh has; ``counts`` are those of ``save_links``."""
    pairs, n_labels, n_closed = [], 0, 0
    for folder, count in zip(folders, counts, strict=True):
        links = load_array(folder / _LINKS).astype(np.int64)
        links[:, 1] += n_labels
        pairs.append(links)
        n_labels += count["open"]
        n_closed += count["closed"]
    if not n_labels:
        return n_closed
    links = np.concatenate(pairs)
    links = links[np.argsort(links[:, 0], kind="stable")]
    same = links[1:, 0] == links[:-1, 0]
    one, other = links[:-1, 1][same], links[1:, 1][same]
    joins = np.stack([one, other, other], axis=1).astype(np.int32)
    used = np.ones(n_labels, dtype=bool)
    return n_closed + count_components(n_labels, joins, used)
