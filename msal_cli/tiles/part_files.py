"""The mesh of a tile and its halo in files, and the state of a computation on it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.kernels.connectivity import Connectivity
from msal_cli.storage.atomic import write_whole

if TYPE_CHECKING:
    from msal_cli.arrays import Flags, Floats, Ints
    from msal_cli.mesh import Mesh

TURNED = "turned.npy"
"""The faces after some were turned; those of ``links`` stay as they were, as in memory."""

_COUNTS, _STATE, _NORMALS = "counts.json", "state", "normals"


@dataclass(frozen=True, eq=False)
class TileMesh:
    """A tile and its halo, ready for computing; arrays of what was loaded are mapped files.

    Attributes
    ----------
    vertices : (n, 3) float64, about the origin of the whole mesh, in the order of the file.
    faces : (m, 3) int32, wound one way, in the order of the file.
    ids : (n,) uint32, numbers of the vertices in tile-major order.
    triangles : (m,) uint32, numbers of the faces in the file.
    own_vertices, own_faces : (n,) and (m,), those of the tile.
    links : neighbourhoods; those of the last ring are not complete.
    """

    vertices: Floats
    faces: Ints
    ids: NDArray[np.uint32]
    triangles: NDArray[np.uint32]
    own_vertices: Flags
    own_faces: Flags
    links: Connectivity

    def save(self, folder: Path) -> None:
        """Write it into a folder."""
        for name in ("vertices", "faces", "ids", "triangles", "own_vertices", "own_faces"):
            save_array(folder / f"{name}.npy", getattr(self, name))
        links = self.links
        for name in ("ring_start", "ring", "boundary"):
            save_array(folder / f"{name}.npy", getattr(links, name))
        counts = [links.boundary_edges, links.inconsistent_edges, links.non_manifold_edges]
        (folder / _COUNTS).write_text(json.dumps(counts), encoding="utf-8")

    @staticmethod
    def load(folder: Path) -> TileMesh:
        """What ``save`` wrote, its faces turned where that was necessary."""
        mesh = TileMesh.load_unturned(folder)
        turned = folder / TURNED
        return replace(mesh, faces=load_array(turned)) if turned.exists() else mesh

    @staticmethod
    def load_unturned(folder: Path) -> TileMesh:
        """What ``save`` wrote."""

        def read(name: str) -> Any:
            return load_array(folder / f"{name}.npy")

        faces = read("faces")
        counts = json.loads((folder / _COUNTS).read_text(encoding="utf-8"))
        links = Connectivity(faces, read("ring_start"), read("ring"), read("boundary"), *counts)
        return TileMesh(
            read("vertices"),
            faces,
            read("ids"),
            read("triangles"),
            read("own_vertices"),
            read("own_faces"),
            links,
        )


def save_array(path: Path, array: NDArray[Any]) -> None:
    """Write an array into a file that appears whole: others may have mapped the one of a task that
    is run again."""
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    array = np.ascontiguousarray(array)
    header = np.lib.format.header_data_from_array_1_0(array)
    try:
        # What numpy raises where there is no space does not say so.
        with open(temporary, "wb") as file:
            np.lib.format.write_array_header_1_0(file, header)
            file.write(array.data.cast("B") if array.size else b"")
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def load_array(path: Path) -> Any:
    """An array of a file, mapped; an empty one cannot be."""
    mapped = np.load(path, mmap_mode="r" if path.stat().st_size > 128 else None)
    return mapped.view(np.ndarray)


def save_normals(folder: Path, mesh: Mesh) -> None:
    """Write the normals that a mesh knows, which every round of a method needs again."""
    for (weighting, passes), normals in mesh.known_normals.items():
        save_array(folder / f"{_NORMALS}-{weighting}-{passes}.npy", normals)


def load_normals(folder: Path, mesh: Mesh) -> None:
    """Have a mesh know the normals that ``save_normals`` wrote for it."""
    known = {}
    for path in folder.glob(f"{_NORMALS}-*-*.npy"):
        _, weighting, passes = path.stem.split("-")
        known[weighting, int(passes)] = load_array(path)
    mesh.take_normals(known)


def save_state(
    folder: Path,
    round_number: int,
    state: Mapping[str, NDArray[Any]],
    saved: Mapping[str, NDArray[Any]],
) -> None:
    """Write named arrays with which the round after this one goes on.

    Those that are the very arrays that were ``saved`` in the round before are not written again.
    """
    before = folder / f"{_STATE}-{round_number - 1}"
    places = {name: before / f"{at}.npy" for at, name in enumerate(saved)}
    place = folder / f"{_STATE}-{round_number}"
    place.mkdir(exist_ok=True)
    for at, (name, array) in enumerate(state.items()):
        path = place / f"{at}.npy"
        if array is not saved.get(name) or not _try_link(places[name], path):
            save_array(path, array)
    write_whole(place / "names.json", json.dumps(list(state)).encode())


def _try_link(path: Path, link: Path) -> bool:
    """Give a file a second name, which may be that of another; False where that cannot be."""
    temporary = link.with_name(f"{link.name}.{os.getpid()}")
    try:
        os.link(path, temporary)
        temporary.replace(link)
    except OSError:
        return False
    finally:
        # To replace a name of the same file does nothing.
        temporary.unlink(missing_ok=True)
    return True


def load_state(folder: Path, round_number: int) -> dict[str, NDArray[Any]]:
    """What ``save_state`` wrote in that round."""
    place = folder / f"{_STATE}-{round_number}"
    names = json.loads((place / "names.json").read_text(encoding="utf-8"))
    return {name: load_array(place / f"{at}.npy") for at, name in enumerate(names)}


def remove_state(folder: Path, round_number: int) -> None:
    """Remove what a round wrote, if anything."""
    shutil.rmtree(folder / f"{_STATE}-{round_number}", ignore_errors=True)
