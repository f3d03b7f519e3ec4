"""Settings and limits of one file, and what is known before it is read: names and forecasts."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from msal_cli.storage.urls import is_url, split

if TYPE_CHECKING:
    from msal_cli.codecs.forecast import Forecast
    from msal_cli.job.records import ObjectMark

AUTO = "auto"
"""In place of a method's name: each mesh gets the one that suits it, see ``selection``."""

ADAPTIVE = "adaptive"
"""In place of a method's name: parameters of AL and MSAL are chosen for each mesh, see
``auto.adaptive``."""

CHOOSING = (ADAPTIVE, AUTO)
"""The words in place of a method for which something is chosen."""

NEGLIGIBLE = "auto"
"""In place of a least noise: as the estimate judges it."""

DEFAULT_BACKUP = ".orig"
"""What is added to the name of an original that is replaced in place."""

SELF_INTERSECTIONS = "self-intersections"
"""What a check is called that counts pairs of faces which intersect each other."""


@dataclass(frozen=True)
class Settings:
    """Everything beside the input that decides the bytes of an output.

    Attributes
    ----------
    method, parameters : the method's name and all its parameters, resolved; with
        ``AUTO`` the fields of ``selection.Wishes``, with ``ADAPTIVE`` none but ``assume``.
    to : suffix of the format to convert to, without a dot; None keeps the input's, or takes the
        output name's.
    encoding : ``same``, ``ascii`` or ``binary``.
    precision : ``same``, ``float32`` or ``float64``.
    strict : a conversion that loses something fails instead of warning.
    format : the input's format where its name does not show it.
    max_move, lock, weights : what keeps vertices near their place; see ``constraints``.
    fields : what is written beside the output, see ``fields``.
    checks : what is counted beside what always is: ``SELF_INTERSECTIONS``.
    despike : whether outlier vertices are brought back before the method runs, see ``outliers``;
        None does so where a method is chosen and the outliers are clear.
    min_noise : below which noise a mesh stays as it is: a length as of ``constraints``, or
        ``NEGLIGIBLE`` for "no noise to speak of".
    tile_set : whether all files are denoised as the one mesh that they are together.
    weld : within which distance border vertices of its files are one: a length as of
        ``constraints``, or None for vertices at the very same place.
    """

    method: str
    parameters: dict[str, Any] = field(default_factory=dict)
    to: str | None = None
    encoding: str = "same"
    precision: str = "same"
    strict: bool = False
    format: str | None = None
    max_move: str | None = None
    lock: tuple[str, ...] = ()
    weights: str | None = None
    fields: tuple[str, ...] = ()
    min_noise: str | None = None
    checks: tuple[str, ...] = ()
    despike: bool | None = None
    tile_set: bool = False
    weld: str | None = None

    @property
    def assume(self) -> str | None:
        """What the choice assumes where noise and texture cannot be told apart, see ``Wishes``."""
        return self.parameters.get("assume") if self.method in CHOOSING else None

    @property
    def looks_for_outliers(self) -> bool:
        """Whether outlier vertices are looked for."""
        return self.method in CHOOSING if self.despike is None else self.despike


@dataclass(frozen=True)
class Limits:
    """What one file may take; None is no limit.  Limits never change the bytes of an output.

    Attributes
    ----------
    timeout_s : seconds of wall time, enforced by the supervisor of the worker.
    memory_bytes : resident memory of the process that denoises it.
    max_faces : faces as the file counts them.
    """

    timeout_s: float | None = None
    memory_bytes: int | None = None
    max_faces: int | None = None


NO_LIMITS = Limits()

_FIELDS_BYTES_PER_FACE = 64
# A second set of positions stays until the output is built.
_OUTLIERS_BYTES_PER_FACE = 12
# A tree of boxes with nine directions, filled up to a power of two; measured: 1,060.
_INTERSECTIONS_BYTES_PER_FACE = 1100

FORECAST = "forecast"
"""The ``where`` of an ``E_MEMORY`` that was forecast: trying again would not help."""


@dataclass(frozen=True)
class Task:
    """One file to denoise; paths are text as ``os.fsdecode`` gives it, or URLs.

    ``relative`` is the name by which reports and the manifest know the file.  With ``in_place``
    the output is the input, and ``backup``, a suffix, keeps the original beside it.  An input in a
    store has the mark that it had when it was found.
    """

    input: str
    output: str
    relative: str
    in_place: bool = False
    backup: str | None = None
    input_mark: ObjectMark | None = None


def is_mesh_name(name: str) -> bool:
    """True if the suffix, a final ``.gz`` aside, is that of a format that can be read."""
    from msal_cli.codecs.detection import readable_suffixes

    return suffix(name) in readable_suffixes()


def writable_formats() -> tuple[str, ...]:
    """The words that ``--to`` takes."""
    from msal_cli.codecs import writable_formats

    return tuple(writable_formats())


def output_name(name: str, to: str | None) -> str:
    """The name of the output for an input's name: another suffix for ``to``; ``.gz`` is kept."""
    if to is None:
        return name
    packed = name[-3:] if name.lower().endswith(".gz") else ""
    stem = name[: len(name) - len(packed)]
    return stem[: len(stem) - len(suffix(name))] + "." + to.lower().lstrip(".") + packed


def suffix(name: str) -> str:
    """The last suffix in lower case with its dot, a final ``.gz`` aside; empty if none."""
    base = os.path.basename(name).lower()
    return os.path.splitext(base.removesuffix(".gz"))[1]


def refuse_unknown_format(output: str) -> None:
    """Refuse a file to write whose suffix is that of no format; UsageError lists those that are.

    A name without a suffix is that of a folder, or of a device such as ``/dev/null``.
    """
    from msal_cli.errors import UsageError

    if is_url(output):
        # A bucket may have a dot in its name.
        output_path = split(output)[1]
        name = output_path.rpartition("/")[2] if "/" in output_path else ""
    else:
        name = os.path.basename(output)
    ending = suffix(name) or os.path.splitext(name)[1]
    if len(ending) < 2 or is_mesh_name(name):
        return
    raise UsageError(
        f"the output {output!r}: {ending!r} is the suffix of no mesh format; "
        f"those that can be written are {', '.join(writable_formats())}",
        hint=f"give the file one of these suffixes, or write {output + '/'!r} for a folder",
    )


def refuse_oversized(forecast: Forecast, limits: Limits) -> None:
    """Refuse a file that is expected to exceed the limits: ResourceError or TooLargeError."""
    from msal_cli.errors import ResourceError
    from msal_cli.machine import megabytes

    refuse_faces(forecast.faces, limits)
    limit = limits.memory_bytes
    if limit is not None and forecast.memory_bytes is not None and forecast.memory_bytes > limit:
        raise ResourceError(
            f"denoising this file takes up to {megabytes(forecast.memory_bytes)}, "
            f"and the limit is {megabytes(limit)}",
            code="E_MEMORY",
            where=FORECAST,
            hint="raise --memory-limit if the machine has more, or cut the mesh into parts",
        )


def refuse_faces(n_faces: int | None, limits: Limits) -> None:
    """Refuse more faces than the limits allow; TooLargeError."""
    from msal_cli.errors import TooLargeError

    most = limits.max_faces
    if most is not None and n_faces is not None and n_faces > most:
        raise TooLargeError(
            f"the file has {n_faces:,} faces, and --max-faces allows {most:,}",
            hint="raise --max-faces, or leave it out",
        )


def forecast(task: Task, settings: Settings) -> Forecast:
    """What a file will need, by its size and its first bytes; it never raises for a file."""
    from msal_cli.codecs import forecast

    named = suffix(task.output).lstrip(".") if is_mesh_name(task.output) else None
    to = settings.to or named
    is_same = to in (None, suffix(task.input).lstrip("."))
    if is_same and settings.encoding == "same" and settings.precision == "same":
        to = None
    told_of = forecast.forecast(
        task.input,
        format=settings.format,
        to=to,
        method_bytes_per_face=method_bytes_per_face(settings),
    )
    if settings.method not in CHOOSING or told_of.memory_bytes is None:
        return told_of
    from msal_cli import auto as selection

    choosing = selection.BYTES if settings.method == AUTO else selection.FAMILY_BYTES
    return dataclasses.replace(told_of, memory_bytes=told_of.memory_bytes + choosing)


def method_bytes_per_face(settings: Settings) -> int:
    """Memory per triangle that the method needs beyond what all do; 0 if there is no such."""
    from msal_cli import methods

    extra = _FIELDS_BYTES_PER_FACE if settings.fields else 0
    if settings.looks_for_outliers:
        extra += _OUTLIERS_BYTES_PER_FACE
    if SELF_INTERSECTIONS in settings.checks:
        extra += _INTERSECTIONS_BYTES_PER_FACE
    if settings.method == AUTO:
        from msal_cli import auto as selection

        most = max(methods.find(name).bytes_per_face for name in selection.METHODS)
        return most + extra
    if settings.method == ADAPTIVE:
        from msal_cli import auto as selection

        return methods.find("al").bytes_per_face_of(selection.LARGEST_OF_FAMILY) + extra
    if settings.method not in methods.names():
        return 0
    return methods.find(settings.method).bytes_per_face_of(settings.parameters) + extra


def least_memory_bytes() -> int:
    """What denoising takes however small the file is: no memory limit can be less."""
    from msal_cli.codecs.forecast import BASE_BYTES

    return BASE_BYTES
