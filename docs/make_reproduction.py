"""Remake the figures and the table of Huang and Ascher from data at hand.

    MSAL_DATA=FOLDER python docs/make_reproduction.py [fig2 fig7 ...]

FOLDER holds scans/ (angel.obj, face000.ply, dragon_vrip_res2.ply.gz), clean/ (stanford-bunny.obj,
igea.ply, fandisk.obj) and pairs/Julius0.2/Original.obj.  Writes the pictures of
docs/images/reproduction and the tables of benchmarks/results/reproduction.txt, all or those named,
and says which it leaves out because a file is missing.  Half a minute of processor time.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from paper_figures import FIGURES, Image, Made, Rows

from msal_cli.view.panels import png_bytes

DOCS = Path(__file__).resolve().parent
TABLES = DOCS.parent / "benchmarks/results/reproduction.txt"
IMAGES = DOCS / "images" / "reproduction"
LARGEST_PICTURE = 270_000  # bytes

PAPER_VOLUMES = {
    "fig7": ("Dragon", (11175335, 11197273, 11110735, 11156748)),
    "fig6": ("Bunny", (1550.7, 1551.9, 1545.1, 1547.5)),
    "fig11": ("Fandisk", (20.243, 20.246, 19.984, 20.180)),
    "fig10": ("Head", (215.0, 215.3, 202.8, 210.5)),
}
"""Table 1: original, noisy, AL, MSAL; and the figure that shows the mesh."""


def table_1(made: dict[str, Made]) -> Rows:
    """Changes of the volume against the noisy mesh, the paper's and ours."""
    rows = [["", "AL, the paper", "AL, here", "MSAL, the paper", "MSAL, here"]]
    for figure, (name, paper) in PAPER_VOLUMES.items():
        row = [name]
        for k in (2, 3):
            for volumes in (paper, made[figure].volumes):
                row.append(f"{100.0 * (volumes[k] / volumes[1] - 1.0):+.2f} %")
        rows.append(row)
    return rows


def markdown(rows: Rows) -> str:
    """Rows as a table, the first one its head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|---|" + "--:|" * (len(rows[0]) - 1))
    return "\n".join(lines) + "\n"


def write_table(name: str, rows: Rows) -> None:
    """Put a table into its place among the results."""
    place = re.compile(rf"(<!-- made: {name} -->\n).*?(?=<!-- end -->)", re.DOTALL)
    text = TABLES.read_text(encoding="utf-8")
    TABLES.write_text(place.sub(lambda at: at[1] + markdown(rows), text), encoding="utf-8")


def write_picture(name: str, picture: Image) -> None:
    """Write a picture with as many colours as its size allows."""
    for most in (256, 128, 64, 32):
        data = png_bytes(picture, most)
        if len(data) <= LARGEST_PICTURE:
            break
    IMAGES.mkdir(parents=True, exist_ok=True)
    (IMAGES / f"{name}.png").write_bytes(data)
    print(f"{name}: {len(data):,} bytes, {most} colours")


def main() -> None:
    if "MSAL_DATA" not in os.environ:
        sys.exit("set MSAL_DATA to the folder that holds scans/, clean/ and pairs/")
    folder = Path(os.environ["MSAL_DATA"])
    wanted = sys.argv[1:] or [*FIGURES]
    if unknown := set(wanted) - {*FIGURES}:
        sys.exit(f"there is no {', '.join(sorted(unknown))}; there are {', '.join(FIGURES)}")
    made = {}
    for name in wanted:
        make, needed = FIGURES[name]
        if not (folder / needed).exists():
            print(f"{name}: left out, there is no {folder / needed}")
            continue
        made[name] = make(folder)
        write_picture(name, made[name].picture)
        if (second := made[name].second) is not None:
            write_picture(f"{name}_curvature", second)
        write_table(name, made[name].table)
        print(markdown(made[name].table))
    if made.keys() >= PAPER_VOLUMES.keys():
        write_table("table1", table_1(made))
        print(markdown(table_1(made)))
    else:
        print("table1: left out, it needs " + ", ".join(PAPER_VOLUMES))


if __name__ == "__main__":
    main()
