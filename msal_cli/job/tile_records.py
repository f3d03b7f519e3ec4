"""What records say of a mesh that was denoised by tiles, and of a file of a tile set."""

from __future__ import annotations

from dataclasses import dataclass, field

from msal_cli.job.plain_data import about, known


@dataclass(frozen=True, slots=True)
class Tiles:
    """How a mesh that does not fit into memory was denoised in parts; of a file that is planned,
    what is expected."""

    number: int = field(metadata=about("tiles that the mesh was cut into"))
    jobs: int = field(metadata=about("tiles at the same time"))
    scratch_bytes: int = field(metadata=about("bytes of temporary files, the output among them"))
    rings: int | None = known("rings of neighbouring vertices that were added to each tile")
    choice_vertices: int | None = known(
        "vertices of the part on which method, parameters and noise were determined; null if it "
        "was the whole mesh"
    )
    resumed_tasks: int | None = known("tasks that an earlier, interrupted run had finished")
    memory_bytes: int | None = known(
        "memory of all processes together that was expected; the highest is in peak_memory_bytes"
    )
    expected_seconds: float | None = known("seconds from start to end that were expected")


@dataclass(frozen=True, slots=True)
class TileSetPart:
    """What a file is within the tile set that was denoised as one mesh; border vertices at one
    place of the file count once."""

    files: int = field(metadata=about("files of the set that could be read"))
    neighbours: tuple[str, ...] = field(
        metadata=about("files, by their relative paths, that share border vertices with this one")
    )
    shared_vertices: int = field(metadata=about("border vertices that other files have, too"))
    welded_vertices: int = field(
        metadata=about(
            "of these, those for which the position of another file was taken, because of --weld "
            "or of fewer digits there"
        )
    )
    largest_weld: float = field(
        metadata=about(
            "largest distance before between vertices of this file and others that are one, file "
            "units"
        )
    )
    unmatched_vertices: int = field(
        metadata=about(
            "border vertices that lie at the border of another file but are no vertices of it"
        )
    )
    fixed_border_vertices: int = field(
        metadata=about(
            "border vertices that were held in their place because a file that failed, or is "
            "gone since an earlier run, may share them"
        )
    )
    low: tuple[float, float, float] | None = known(
        "least coordinates of its border vertices before, file units; null if it has none"
    )
    high: tuple[float, float, float] | None = known("greatest coordinates of them")
