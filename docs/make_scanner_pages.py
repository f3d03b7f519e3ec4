"""Make the table "Your scanner" of noise.md with its pictures, and the tables of accuracy.md.

    MSAL_DATA=FOLDER python docs/make_scanner_pages.py --cache FILE.json [--no-pictures]

FILE.json is the cache of ``python -m benchmarks.scanners``, with all kinds run; the figures come
from it, and the pictures from the sample meshes.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import make_pictures
from scanner_examples import EXAMPLES, Example, true_mesh

from benchmarks import scanner_cases, scanner_outcomes, scanners
from benchmarks.scanner_outcomes import Outcomes
from msal_cli.view.panels import png_bytes
from msal_cli.view.rendering import frame_vertices, rotate, shade

Image = NDArray[np.uint8]

DOCS = Path(__file__).resolve().parent
IMAGES = DOCS / "images" / "scanners"
RESULTS = DOCS.parent / "benchmarks/results/scanners.txt"
SIZE = (200, 200)
COMMAND = "auto"
COLUMNS = (0, 1, 2, 4, 5, 8, -1)
"""Of the table of scanners: kind, noisy, plain command, --auto, best single setting."""
LARGEST_PICTURE = 150_000  # bytes


def draw(example: Example) -> Image:
    """The noisy mesh, what ``--auto`` makes of it, and the truth, side by side."""
    true = true_mesh(example.model)
    noisy = example.make(true)
    result = noisy.with_vertices(scanner_outcomes.denoise(noisy, COMMAND)[0])
    turn = make_pictures.VIEWS[example.model]
    axes = rotate(np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0]), *turn)
    camera = frame_vertices(axes, true.vertices)
    return make_pictures.row(
        [shade(mesh.vertices, mesh.faces, camera, *SIZE) for mesh in (noisy, result, true)]
    )


def write_picture(name: str, picture: Image) -> None:
    """Write a picture with as many colours as its size allows."""
    for most in (256, 128, 64, 32, 16):
        data = png_bytes(picture, most)
        if len(data) <= LARGEST_PICTURE:
            break
    IMAGES.mkdir(parents=True, exist_ok=True)
    (IMAGES / f"{name}.png").write_bytes(data)
    print(f"{name}: {len(data):,} bytes, {most} colours")


def scanner_table() -> list[str]:
    """The table "Your scanner"."""
    lines = ["| your scanner | what its noise is like | what msal does | |", "|---|---|---|---|"]
    for example in EXAMPLES:
        picture = f"![Noisy, denoised, and the truth](images/scanners/{example.name}.png)"
        lines.append(f"| {example.scanner} | {example.noise} | {example.does} | {picture} |")
    return lines


def summary(lines: list[str]) -> list[str]:
    """The table of accuracy.md and what it shows: some columns, and no clean meshes."""
    end = next((at for at, line in enumerate(lines) if line.startswith("Clean meshes")), len(lines))
    shown = [
        "|".join(
            re.sub(r" \([^)]*\) $", " ", line.split("|")[k]) if k == 8 else line.split("|")[k]
            for k in COLUMNS
        )
        if line.startswith("|")
        else line
        for line in lines[:end]
    ]
    return shown[: len(shown) - (shown[-1] == "")]


def put(page: Path, name: str, lines: list[str]) -> None:
    """Put lines into a page where it has a place of that name."""
    place = re.compile(rf"(<!-- made: {name} -->\n).*?(?=<!-- end -->)", re.DOTALL)
    text = page.read_text(encoding="utf-8")
    if not place.search(text):
        sys.exit(f"{page.name} has no place for {name}")
    made = "\n".join(lines) + "\n"
    page.write_text(place.sub(lambda at: at[1] + made, text), encoding="utf-8", newline="\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cache", type=Path, required=True, help="cache of benchmarks.scanners")
    parser.add_argument("--no-pictures", action="store_true", help="only the tables of figures")
    given = parser.parse_args()
    outcomes = Outcomes(given.cache, None)
    found = {kind: outcomes.known(some) for kind, some in scanner_cases.cases().items()}
    found = {kind: rows for kind, rows in found.items() if rows}
    put(DOCS / "accuracy.md", "scanners", summary(scanners.section(found, [])))
    tables = "\n".join(scanners.section(found, ["models"]))
    RESULTS.write_text(
        f"python -m benchmarks.scanners\n\n{tables}\n", encoding="utf-8", newline="\n"
    )
    put(DOCS / "noise.md", "your scanner", scanner_table())
    if given.no_pictures:
        return
    for one in EXAMPLES:
        write_picture(one.name, draw(one))


if __name__ == "__main__":
    main()
