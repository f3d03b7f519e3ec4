"""Fields of a record: the defects and the noise of a mesh, and what denoising changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from msal_cli.job import records
from msal_cli.kernels.quantiles import quantiles
from msal_cli.light_dataclass import dataclass

if TYPE_CHECKING:
    from msal_cli.analysis.measures import DistanceStatistics, Harm
    from msal_cli.arrays import Floats
    from msal_cli.codecs.mesh_file import MeshFile
    from msal_cli.mesh import Mesh, PreparedMesh
    from msal_cli.methods import Method

INSIDE_OUT = "W_INSIDE_OUT"
"""Code of the warning about a closed surface whose normals point inwards."""

_WITHOUT = "without a method and parameters (--method, -n, -K, --mollify, --schedule, --set)"
_MIN_MOVE_EDGES = 0.005
"""Mean displacement in mean edge lengths below which a named method causes no warning."""

_LITTLE_EDGES = 0.025
"""Upper end of the level of noise, mean edge lengths, below which there is none to speak of."""

_RULED = 0.2
"""One spike rules lambda if its 99th percentile is below this.  Without spikes it is 0.28 or
more on scans and on models with any noise; with one of ten mean edge lengths it is 0.11 to 0.15."""

_MAX_SAMPLED = 16_384
"""Vertices at which lambda is sampled, about."""

_OF_LEVEL = ("mean_edges", "file_units", "rms_edges", "tail", "regions")
_OF_CHARACTER = ("kind", "rings", "direction", "axis", "outliers", "confidence", "basis", "words")
"""Fields of the record that have the same names in the estimate."""

_DEFECTS = (
    *("components", "boundary_edges", "non_manifold_edges", "inconsistent_edges"),
    *("degenerate_faces", "duplicate_faces", "unreferenced_vertices"),
)
"""Fields of the record that have the same names in the defects of a mesh."""

_DAMAGE_ADVICE = "try --auto, another method, fewer sweeps or --max-move"


@dataclass(frozen=True)
class Measured:
    """What denoising changed: fields of the record, warnings as (code, text), and any harm."""

    fields: dict[str, Any]
    warnings: tuple[tuple[str, str], ...]
    harm: Harm | None


def defect_fields(ready: PreparedMesh, n_merged: int) -> dict[str, Any]:
    """The defects as fields of the record; the reader has merged ``n_merged`` vertices."""
    return {name: getattr(ready.defects, name) for name in _DEFECTS} | {
        "welded_vertices": ready.defects.welded_vertices + n_merged,
        "mean_edge_length": ready.mesh.mean_edge_length,
    }


def file_fields(mesh_file: MeshFile) -> dict[str, Any]:
    """Format and counts of a file as fields of the record."""
    return {
        "format": mesh_file.format,
        "encoding": mesh_file.encoding,
        "precision": mesh_file.precision,
        "vertices": len(mesh_file.vertices),
        "corners": mesh_file.n_corners,
        "faces": mesh_file.n_polygons,
        "triangles": len(mesh_file.faces),
    }


def noise_field(mesh: Mesh) -> records.NoiseEstimate:
    """The estimated noise of a mesh as a field of the record."""
    from msal_cli.analysis.noise_estimate import estimate_noise

    level = estimate_noise(mesh)
    character = level.character
    return records.NoiseEstimate(
        **{name: getattr(level, name) for name in _OF_LEVEL},
        **{name: getattr(character, name) for name in _OF_CHARACTER},
        low_edges=level.low,
        high_edges=level.high,
        negligible=level.is_negligible,
        lowest_edges=level.lowest,
        highest_edges=level.highest,
        uneven=level.is_uneven,
        step_edges=character.step,
        unsure=level.is_unsure,
        readings=tuple(
            records.NoiseReading(reading.kind, reading.level, reading.probability)
            for reading in level.readings
        ),
    )


def displacement_field(statistics: DistanceStatistics, edge: float) -> records.Displacement:
    """How far vertices moved; ``edge`` is the mean edge length before."""
    lengths = distance_fields(statistics, edge)
    return records.Displacement(**lengths, moved_vertices=statistics.n_moved)


def distance_fields(statistics: DistanceStatistics, edge: float) -> dict[str, float]:
    """Distances in file units and, with names in ``_edges``, in the mean edge length before."""
    lengths = {name: getattr(statistics, name) for name in ("mean", "rms", "p95", "max")}
    return lengths | {f"{name}_edges": length / edge for name, length in lengths.items()}


def size_fields(
    areas: tuple[float, float], volumes: tuple[float, float], objection: str
) -> dict[str, Any]:
    """Areas and enclosed volumes, before and after, as fields of the record; ``objection`` is the
    reason why the volumes are not valid, empty if they are."""
    from msal_cli.analysis.measures import relative_volume_change

    share = relative_volume_change(*volumes, areas[0])
    percent = None if share is None else 100.0 * share
    change, growth = volumes[1] - volumes[0], areas[1] - areas[0]
    return {
        "volume": records.Volume(*volumes, change, percent, not objection, objection),
        "area": records.Area(*areas, 100.0 * growth / areas[0] if areas[0] else None),
    }


def measure(ready: PreparedMesh, moved: Floats, given: Mesh, *, is_named: bool = True) -> Measured:
    """Measure what changed when the mesh's positions became ``moved`` (n, 3).

    ``given`` is the mesh that the method got: its noise does not explain the displacement of
    outliers, which were brought back before.  ``is_named`` is whether the user named the method, or
    none ran; a chosen method gets less leeway.
    """
    from msal_cli.analysis import measures

    before, after = ready.mesh, ready.mesh.with_vertices(moved)
    statistics = measures.displacement(before, after)
    surface = measures.measure_surface_change(before, after)
    objection = ready.defects.volume_objection
    enclosed = measures.enclosure_of(before, ready.defects, surface.areas[0], surface.volumes[0])
    surface = enclosed.change(before, after, surface)
    warnings = [(INSIDE_OUT, enclosed.words)] if enclosed.is_inside_out else []
    known = noise_field(given)
    harm = measures.harmful_change(before, after, surface, has_volume=not objection)
    if harm is None:
        level = max(known.high_edges or 0.0, known.rms_edges or 0.0, known.mean_edges)
        if known.step_edges:
            # Steps give the level exactly, and it moved no vertex by more than half of one.
            level = known.mean_edges
        distances, change = statistics, surface
        if given.vertices is not before.vertices:
            distances = measures.displacement(given, after)
            change = enclosed.change(given, after, measures.measure_surface_change(given, after))
        harm = measures.excessive_change(
            given,
            after,
            change,
            level,
            distances.p95 / before.mean_edge_length,
            has_volume=not objection,
            leeway=measures.NAMED_LEEWAY if is_named else 1.0,
        )
    if harm is not None:
        warnings.append((harm.code, f"this looks like damage: {harm.reason}; {_DAMAGE_ADVICE}"))
    fields = {
        "displacement": displacement_field(statistics, before.mean_edge_length),
        "normal_change": records.NormalChange(
            surface.mean_angular_error_deg, surface.max_angular_error_deg
        ),
        "flipped_faces": surface.flipped_faces,
        "noise_estimate": known,
        "inside_out": enclosed.is_inside_out,
        **size_fields(surface.areas, surface.volumes, objection),
    }
    return Measured(fields, tuple(warnings), harm)


def method_warnings(
    method: Method,
    parameters: Mapping[str, Any],
    noise: records.NoiseEstimate,
    displacement: records.Displacement,
    is_ruled: bool,
) -> tuple[str, ...]:
    """Warnings that a method which the user named harms the mesh, each with a better way.

    There is none about too much noise where that may be texture: it is not known what is better.
    ``is_ruled`` is the result of ``is_ruled_by_spike``.
    """
    if displacement.mean_edges < _MIN_MOVE_EDGES:
        return ()
    if noise.negligible and noise.high_edges < _LITTLE_EDGES:
        return (
            f"no noise to speak of, and {method.name} moved vertices by "
            f"{displacement.mean_edges:.2g} e: --min-noise auto leaves such meshes as they are, "
            f"and so does msal {_WITHOUT}",
        )
    warnings = []
    max_noise = method.most_noise_edges(parameters)
    # Rounded as it is printed: else 0.15 could exceed a limit of 0.15.
    if round(noise.mean_edges, 2) > max_noise and not noise.unsure:
        warnings.append(
            f"noise {noise.mean_edges:.2g} e is more than {method.name} is made for with these "
            f"parameters (about {max_noise:g} e): --auto is better, and so is msal {_WITHOUT}"
        )
    if is_ruled and method.uses_largest_sigma(parameters):
        warnings.append(
            "one spike rules lambda, which is next to nothing elsewhere: try --schedule robust"
        )
    return tuple(warnings)


def is_ruled_by_spike(fidelity: Floats | None) -> bool:
    """Whether lambda (n,) of the first sweep is nearly everywhere small against its maximum, 1."""
    if fidelity is None:
        return False
    sample = fidelity[:: max(len(fidelity) // _MAX_SAMPLED, 1)]
    sample = sample[sample > 0.0]
    return len(sample) > 0 and float(quantiles(sample, (0.99,))[0]) < _RULED
