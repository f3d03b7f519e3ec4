"""Fields for ``msal denoise --fields``: numbers at the vertices that show what denoising did."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from msal_cli.analysis.measures import local_scale, mean_curvature, measure_enclosure
from msal_cli.analysis.noise_estimate import estimate_regions
from msal_cli.arrays import Floats
from msal_cli.codecs import colours, ply_write
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.errors import OutputError
from msal_cli.job.records import FieldsFile
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import PreparedMesh
from msal_cli.storage.atomic import Sources, write_whole
from msal_cli.storage.gzip_streams import is_gzip_name
from msal_cli.storage.regular import Buffer, open_regular
from msal_cli.storage.urls import is_url
from msal_cli.version import __version__

SUFFIX = ".fields.ply"
"""Replaces the suffix of an output."""


@dataclass(frozen=True)
class Kind:
    """What a field means, its colour map, and the quantile of its values (absolute ones with the
    diverging map) that ends the range of colours."""

    meaning: str
    map: str
    quantile: float


KINDS = {
    "lambda": Kind(
        "pull back to the input in the first sweep, eq. (7): sigma / max sigma", "sequential", 0.99
    ),
    "sigma": Kind("local scale of the input, eq. (4), file units", "sequential", 0.99),
    "noise": Kind(
        "noise of the input around the vertex, by region, file units", "sequential", 0.99
    ),
    "displacement": Kind("move along the normal, outward positive, file units", "diverging", 0.99),
    "curvature": Kind(
        "mean curvature of the output, bulges positive, 1 / file units; 0 at open edges",
        "diverging",
        0.95,
    ),
}
"""The fields by the names under which they are stored."""


def path_beside(output: str) -> str:
    """The path of the file with the fields of an output."""
    stem = output[:-3] if is_gzip_name(output) else output
    return os.path.splitext(stem)[0] + SUFFIX


def compute(
    names: Sequence[str],
    ready: PreparedMesh,
    moved: Floats,
    fidelity: Floats | None,
    parameters: Mapping[str, Any],
) -> dict[str, Floats]:
    """The fields of a mesh that was denoised to ``moved`` (n, 3), at the file's vertices (n_file,).

    sigma, and the direction of a displacement, are measured along the normals that the method uses
    with its ``parameters``.  ``fidelity`` (n,) is lambda of the method's first sweep; without it,
    or where it is all 0, lambda is sigma / max sigma.  Vertices that no face uses have 0.  Outward
    is away from the solid, also where its surface is inside out.
    """
    mesh = ready.mesh
    normals = mesh.vertex_normals(
        parameters.get("normals", "uniform"), parameters.get("mollify", 1)
    )
    outwards = measure_enclosure(ready).outward_signs(mesh)
    values: dict[str, Floats] = {}
    for name in names:
        if name == "displacement":
            field = outwards * ((moved - mesh.vertices) * normals).sum(axis=1)
        elif name == "curvature":
            field = outwards * mean_curvature(mesh.with_vertices(moved))
        elif name == "noise":
            field = estimate_regions(mesh)
        else:
            field = local_scale(mesh, normals)
            largest = float(field.max(initial=0.0))
            if name == "lambda" and fidelity is not None and fidelity.any():
                field = fidelity
            elif name == "lambda" and largest > 0.0:
                field = field / largest
        values[name] = np.where(mesh.topology.has_ring, field, 0.0)
        if ready.vertex_map is not None:
            values[name] = np.where(ready.vertex_map >= 0, values[name][ready.vertex_map], 0.0)
    return values


def build_file(
    mesh_file: MeshFile, vertices: Floats, values: Mapping[str, Floats], path: str
) -> tuple[Buffer, FieldsFile]:
    """A PLY of the output, with its fields and the colours of the first one, and its record.

    ``vertices`` (n, 3) are the new positions, ``values`` (n,) by name, at least one.
    """
    names = tuple(values)
    kind = KINDS[names[0]]
    comments = [f"msal {__version__}: fields of a denoised mesh"]
    comments += [
        f"{name}: {KINDS[name].meaning}; {field.min():.6g} to {field.max():.6g}"
        for name, field in values.items()
    ]
    data, low, high = with_colours(mesh_file, vertices, values, kind, comments)
    digest = hashlib.sha256(data).hexdigest()
    return data, FieldsFile(path, names, names[0], kind.map, low, high, digest)


def with_colours(
    mesh_file: MeshFile,
    vertices: Floats,
    values: Mapping[str, Floats],
    kind: Kind,
    comments: Sequence[str],
    remark: str = "",
) -> tuple[Buffer, float, float]:
    """A PLY with fields (n,) at its vertices (n, 3), the first one, of this ``kind``, as colours,
    too; and the range of the colours.  A ``remark`` ends the comment about these.

    A quantile bounds the range, so that a few outliers do not leave all the rest in one colour.
    """
    name, shown = next(iter(values.items()))
    is_signed = kind.map == "diverging"
    high = float(np.quantile(np.abs(shown) if is_signed else shown, kind.quantile))
    low = -high if is_signed else 0.0
    ends = "blue over pale to brown" if is_signed else "pale to dark"
    scale = f"{ends} for {name} {low:.6g} to {high:.6g} (quantile {kind.quantile:g}{remark})"
    data = ply_write.write_ply(
        vertices,
        *mesh_file.polygons(),
        single=mesh_file.precision == "float32",
        colours=colours.map_colours(shown, low, high, kind.map),
        fields=values,
        comments=(*comments, f"colours: map {kind.map}, {scale}"),
    )
    return data, low, high


def write_file(data: Buffer, described: FieldsFile, sources: Sources) -> None:
    """Write a file of fields; OutputError if it would replace any other file."""
    path = described.path
    head = None
    try:
        if not is_url(path):
            with open_regular(path) as existing:
                head = existing.read(200)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise OutputError(f"the fields cannot be written: {error.strerror}", path=path) from None
    if head is not None and (
        b"\ncomment msal " not in head or b": fields of a denoised mesh\n" not in head
    ):
        raise OutputError(
            f"{path!r} exists, and no --fields wrote it",
            hint="move it away, or choose another output folder",
            path=path,
        )
    write_whole(path, [data], sources=sources)
