"""Make the pictures of these pages from the sample meshes, with the installed package.

    python docs/make_pictures.py

Needs nothing but msal itself; takes some seconds.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli import codecs, methods
from msal_cli.auto import Wishes, adaptive, search
from msal_cli.codecs.mesh_file import Surface
from msal_cli.mesh import prepare_mesh
from msal_cli.storage import gzip_streams
from msal_cli.view import pictures, sweep
from msal_cli.view.panels import png_bytes
from msal_cli.view.rendering import frame_vertices, rotate, shade

Array = NDArray[Any]

DOCS = Path(__file__).resolve().parent
SAMPLES = DOCS.parent / "sample_meshes"
GAP = 10  # pixels between panels

VIEWS = {  # turn and tilt in degrees
    "bracket": (35.0, 28.0),
    "dragon_egg": (20.0, 15.0),
    "coin": (0.0, 82.0),
    "bear": (25.0, 10.0),
    "vase": (20.0, 18.0),
    "knot": (0.0, 70.0),
    "toadstool": (0.0, 14.0),
    "rock": (20.0, 20.0),
}


def opened(path: Path) -> tuple[Array, Array]:
    """Vertices (n, 3) and triangles (m, 3) of a sample."""
    data = gzip_streams.expand(path.read_bytes(), path.name)
    mesh_file = codecs.open_mesh(data, path.name)
    return mesh_file.vertices, mesh_file.faces


def denoised(path: Path, method: str, **parameters: Any) -> tuple[Array, Array]:
    """Vertices and triangles of a sample after a method, as ``msal denoise`` makes them."""
    vertices, faces = opened(path)
    ready = prepare_mesh(vertices, faces)
    chosen = methods.find(method)
    result = chosen.denoise(ready.mesh, chosen.validate(parameters))
    return ready.to_file_vertices(result.vertices, vertices), faces


def plain(path: Path) -> tuple[Array, Array]:
    """The same as ``msal denoise`` without a method makes them."""
    vertices, faces = opened(path)
    choice = adaptive.choose_adaptive(prepare_mesh(vertices, faces).mesh)
    return denoised(path, choice.method, **choice.parameters)


def automatic(path: Path) -> tuple[Array, Array]:
    """The same as ``msal denoise --auto`` makes them."""
    vertices, faces = opened(path)
    choice = search.choose_method(prepare_mesh(vertices, faces).mesh, Wishes())
    return denoised(path, choice.method, **choice.parameters)


def sample(name: str, kind: str) -> Path:
    """The path of a sample, whatever its format."""
    (path,) = SAMPLES.glob(f"{name}_{kind}.*")
    return path


def vertex_colours(name: str) -> Array | None:
    """(n, 3) colours per vertex where the sample has them: stored, or from its texture."""
    if name == "toadstool":
        lines = sample(name, "clean").read_text().splitlines()
        start = lines.index("end_header") + 1
        rows = [line.split() for line in lines[start:] if line.count(" ") == 6]
        return np.array([row[3:6] for row in rows if "." in row[0]], dtype=float)
    if name == "vase":
        return _textured(sample(name, "clean").read_text())
    return None


def _textured(text: str) -> Array:
    image = _read_png(SAMPLES / "vase.png").astype(float)
    lines = [line.split() for line in text.splitlines()]
    uv = np.array([line[1:] for line in lines if line[:1] == ["vt"]], dtype=float)
    count = sum(line[:1] == ["v"] for line in lines)
    colours = np.zeros((count, 3))
    for line in lines:
        if line[:1] == ["f"]:
            for corner in line[1:]:
                vertex, place = (int(part) - 1 for part in corner.split("/"))
                column = int(uv[place, 0] * 255.999) % 256
                colours[vertex] = image[255 - int(min(uv[place, 1], 0.999) * 256), column]
    return colours


def _read_png(path: Path) -> Array:
    """The picture that the script of the samples wrote: one IDAT, no row filters."""
    data = path.read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    (length,) = struct.unpack(">I", data[33:37])
    rows = np.frombuffer(zlib.decompress(data[41 : 41 + length]), np.uint8)
    return rows.reshape(height, 1 + 3 * width)[:, 1:].reshape(height, width, 3)


def panel(name: str, mesh: tuple[Array, Array], size: tuple[int, int]) -> Array:
    """One mesh as a picture, framed as the clean one is."""
    axes = rotate(np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0]), *VIEWS[name])
    camera = frame_vertices(axes, opened(sample(name, "clean"))[0])
    stored = vertex_colours(name)
    colours = None if stored is None else stored.astype(np.uint8)
    return shade(*mesh, camera, *size, colours)


def compared(name: str) -> Array:
    """What ``msal view`` shows of a noisy sample and its denoised surface."""
    vertices, faces = opened(sample(name, "noisy"))
    moved, _ = plain(sample(name, "noisy"))
    names = (f"{name}_noisy.ply", f"{name}.ply")
    scene = pictures.scene_of(Surface(vertices, faces), Surface(moved, faces), names)
    return pictures.draw_picture(scene, pictures.View(size=420))


def tried(name: str) -> Array:
    """What ``msal sweep`` shows of a noisy sample, with the clean one as its reference."""
    view = pictures.View(size=230)
    noisy, clean = (Surface(*opened(sample(name, kind))) for kind in ("noisy", "clean"))
    on = sweep.subject(noisy, f"{name}_noisy.ply", clean, f"{name}_clean.ply", view)
    wanted = sweep.grid(methods.find("msal"), "iterations=2,4", "K=0.25,0.5,1", {})
    made = sweep.cells(on, wanted)
    done = [(cell, pictures.panel(mesh, on.camera, view)) for cell, mesh, _ in made]
    return sweep.sheet(on, wanted, done, view)


def write_png(path: Path, image: Array, max_colours: int = 256) -> None:
    """Write a picture as small as a page wants it."""
    path.write_bytes(png_bytes(image, max_colours))


def row(panels: list[Array]) -> Array:
    """Panels side by side on white."""
    gap = np.full((panels[0].shape[0], GAP, 3), 255, np.uint8)
    parts = [part for one in panels for part in (one, gap)][:-1]
    return np.concatenate(parts, axis=1)


def main() -> None:
    folder = DOCS / "images"
    folder.mkdir(exist_ok=True)
    rows = []
    for name, size in (("coin", (350, 350)), ("bracket", (350, 270))):
        noisy = sample(name, "noisy")
        shown = [opened(noisy), automatic(noisy), opened(sample(name, "clean"))]
        rows.append(row([panel(name, mesh, size) for mesh in shown]))
    write_png(folder / "coin_and_bracket.png", np.concatenate(rows))

    egg = sample("dragon_egg", "noisy")
    size = (270, 370)
    shown = [opened(egg), denoised(egg, "al"), denoised(egg, "msal")]
    shown.append(opened(sample("dragon_egg", "clean")))
    write_png(folder / "al_msal.png", row([panel("dragon_egg", mesh, size) for mesh in shown]))

    size = (270, 240)
    rows = []
    for name in ("bracket", "coin"):
        noisy = sample(name, "noisy")
        shown = [opened(noisy), plain(noisy), automatic(noisy)]
        shown.append(opened(sample(name, "clean")))
        rows.append(row([panel(name, mesh, size) for mesh in shown]))
    write_png(folder / "auto.png", np.concatenate(rows))

    bear = sample("bear", "noisy")
    size = (270, 300)
    shown = [opened(bear), *(denoised(bear, "msal", K=k) for k in (0.25, 0.5, 1.0))]
    write_png(folder / "k.png", row([panel("bear", mesh, size) for mesh in shown]))

    size = (230, 230)
    names = ("bracket", "vase", "knot", "toadstool")
    above = row([panel(name, opened(sample(name, "noisy")), size) for name in names])
    below = row(
        [panel(name, denoised(sample(name, "noisy"), "msal", K=0.7), size) for name in names]
    )
    write_png(folder / "models.png", np.concatenate([above, below]))
    write_png(folder / "view.png", compared("coin"))
    write_png(folder / "sweep.png", tried("dragon_egg"), 128)


if __name__ == "__main__":
    main()
