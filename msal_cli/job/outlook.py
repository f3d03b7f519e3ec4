"""What denoising a file will take, and whether it will fail, before it is denoised.

Seconds are those of one core of a machine like that of docs/performance.md, with nothing else to
do.  They were fitted to the sample meshes and to benchmarks/auto_seconds.py.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from msal_cli.errors import MsalError
from msal_cli.job.records import Failure, MeshRecord, Planned
from msal_cli.job.room import scratch_of_task
from msal_cli.job.settings import ADAPTIVE, AUTO, Limits, Settings, Task, forecast, refuse_faces
from msal_cli.storage.limits import LOOKED_AT
from msal_cli.storage.urls import is_url

# Seconds for any mesh, and per million vertices, from reading to writing.
_METHOD_S, _METHOD_S_PER_MILLION = 0.05, 0.9
_ADAPTIVE_S, _ADAPTIVE_S_PER_MILLION = 0.17, 1.6
_AUTO_S, _AUTO_S_PER_MILLION = 2.2, 28.0

# The filter of ``msal`` alone, by which costs of methods are counted, and a cost for the others.
_FILTER_S_PER_MILLION = 0.13
_USUAL_COST = 20.0

_IN_FILES_S_PER_MILLION = 2.0
"""What the disk adds where arrays are in files: about 2 kB are read for each vertex."""

_BYTES_PER_VERTEX = 75
"""Of a text with twice as many triangles as vertices, and no more than positions."""

_PACKED = 3
"""How often larger a text is than when it is compressed."""


def foresee(record: MeshRecord, task: Task, settings: Settings, limits: Limits) -> MeshRecord:
    """A record of a file that is planned, with its size and the seconds that it will take; failed
    where its size and its first 64 KB show that it will fail."""
    expected = forecast(task, settings)
    size = _size(task)
    n = expected.vertices
    if expected.format == "stl" and expected.faces is not None:
        # A closed surface has half as many vertices as facets, once its corners are welded.
        n = expected.faces // 2
    if n is None and size is not None:
        n = size * (_PACKED if task.input.lower().endswith(".gz") else 1) // _BYTES_PER_VERTEX
    try:
        if not is_url(task.input):
            counted = _check(task.input, settings.format)
            n = n if counted is None else counted
        refuse_faces(expected.faces, limits)
        scratch = scratch_of_task(task, expected, limits)
    except MsalError as error:
        failure = Failure(error.code, error.message, error.hint, error.where)
        return replace(record, status="failed", output=None, error=failure)
    seconds = None if n is None else _seconds(n, settings)
    memory, in_files = expected.memory_bytes, None
    if scratch is not None:
        memory, in_files = scratch.room, scratch.n_bytes
        seconds = None if n is None else _seconds(n, settings) + _IN_FILES_S_PER_MILLION * n / 1e6
    planned = Planned(size, n, None if seconds is None else round(seconds, 2), memory, in_files)
    return replace(record, format=expected.format or None, planned=planned)


def _size(task: Task) -> int | None:
    if task.input_mark is not None:
        return task.input_mark.size
    try:
        return Path(task.input).stat().st_size
    except (OSError, ValueError):
        return None


def _check(path: str, format: str | None) -> int | None:
    """Raise what the reader of a local file would, as far as it is known without all of it; a file
    as small as a header is read as a whole, and its vertices are returned."""
    from msal_cli import codecs
    from msal_cli.codecs import header_check
    from msal_cli.storage import gzip_streams

    try:
        is_small = os.stat(path).st_size <= LOOKED_AT
    except (OSError, ValueError):
        is_small = True
    if is_small:
        data, _ = gzip_streams.expand(header_check.read_input(path, format), path)
        return len(codecs.open_mesh(data, path, format).vertices)
    header_check.check_beginning(path, format)
    return None


def _seconds(n_vertices: int, settings: Settings) -> float:
    millions = n_vertices / 1e6
    if settings.method == AUTO:
        return _AUTO_S + _AUTO_S_PER_MILLION * millions
    if settings.method == ADAPTIVE:
        return _ADAPTIVE_S + _ADAPTIVE_S_PER_MILLION * millions
    from msal_cli.auto.candidates import CANDIDATES

    costs = [one.cost for one in CANDIDATES if one.method == settings.method]
    filters_s = (max(costs) if costs else _USUAL_COST) * _FILTER_S_PER_MILLION
    return _METHOD_S + (_METHOD_S_PER_MILLION + filters_s) * millions
