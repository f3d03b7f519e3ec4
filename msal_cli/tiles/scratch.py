"""The scratch folder of one run by tiles: large arrays in files, and the results of finished tasks.

Every array is a file of raw numbers that tasks map into memory for as long as they need it; tasks
write to ranges of their own.  The result of a task is a small JSON file that appears whole once all
that the task wrote is on the disk, so that a run that was killed goes on from finished tasks.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.errors import InternalError, OutputError
from msal_cli.storage.atomic import write_whole

_DONE, _TILES, _REDUCED = "done", "tiles", "reduced.json"


class Scratch:
    """A folder ``path`` of temporary data; it may lie on a file system that many machines share."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    # Arrays

    def create(self, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
        """A file for an array, full of zeros that take no space until they are written."""
        size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
        with open(self.path / name, "wb") as file:
            file.truncate(size)

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        return (self.path / name).exists()

    def array(self, name: str, dtype: Any, columns: int = 1, *, writable: bool = False) -> Any:
        """The array in a file, mapped: (n,), or (n, ``columns``) for more than one."""
        path = self.path / name
        if not path.stat().st_size:
            shape: tuple[int, ...] = (0,) if columns == 1 else (0, columns)
            return np.empty(shape, dtype)
        mapped = np.memmap(path, dtype=dtype, mode="r+" if writable else "r")
        return mapped if columns == 1 else mapped.reshape(-1, columns)

    def read_range(self, name: str, dtype: Any, start: int, stop: int, columns: int = 1) -> Any:
        """Rows ``start`` to ``stop`` of the array in a file, read without mapping it."""
        row = np.dtype(dtype).itemsize * columns
        count = (stop - start) * columns
        values = np.fromfile(self.path / name, dtype, count, offset=start * row)
        if len(values) != count:
            raise InternalError(f"the file {name} in scratch ends too early")
        return values if columns == 1 else values.reshape(-1, columns)

    def write_range(self, name: str, first_byte: int, values: Any) -> None:
        """Write numbers into a file that exists, without mapping it."""
        self.write_ranges(name, [(first_byte, values)])

    def write_rows(self, name: str, rows: NDArray[np.uint32], values: Any) -> None:
        """Write values (k, ...) into these rows (k,) of a file that exists, without mapping it.

        A map of a file for which there is no space ends the process.
        """
        order = np.argsort(rows, kind="stable")
        ascending, sorted_values = rows[order].astype(np.int64), values[order]
        cuts = np.flatnonzero(np.diff(ascending) != 1) + 1
        size = values[:1].nbytes
        self.write_ranges(
            name,
            (
                (int(ascending[first]) * size, sorted_values[first:last])
                for first, last in zip([0, *cuts], [*cuts, len(rows)], strict=True)
                if last > first
            ),
        )

    def write_ranges(self, name: str, ranges: Iterable[tuple[int, Any]]) -> None:
        """The same for several ranges, each with its first byte and its numbers."""
        with open(self.path / name, "r+b", buffering=0) as file:
            for first_byte, values in ranges:
                file.seek(first_byte)
                view = np.ascontiguousarray(values).data.cast("B") if np.size(values) else b""
                while len(view):
                    view = view[file.write(view) :]

    def tile_folder(self, tile: int) -> Path:
        """The folder of a tile's own files."""
        folder = self.path / _TILES / str(tile)
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @contextmanager
    def explain_failures(self) -> Iterator[None]:
        """Raise OutputError for what the system refuses about the folder: no space, mostly."""
        try:
            yield
        except OSError as failure:
            if failure.errno == errno.ENOMEM:
                raise
            raise OutputError(
                f"the temporary files of tiles: {failure.strerror or failure}",
                path=str(self.path),
                hint="make room there, or choose another folder by --scratch",
            ) from failure

    # The plan and the results of tasks

    def write_json(self, name: str, value: Any) -> None:
        """Write a small file whole."""
        write_whole(self.path / name, json.dumps(value).encode())

    def read_json(self, name: str) -> Any:
        """What ``write_json`` wrote; None if it is not there."""
        try:
            return json.loads((self.path / name).read_bytes())
        except FileNotFoundError:
            return None

    def finish(self, stage: str, index: int, result: Any) -> None:
        """Record the result of a task: what it wrote is complete."""
        folder = self.path / _DONE / stage
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / f"{index}.json", json.dumps(result).encode())

    def result(self, stage: str, index: int) -> Any:
        """The result of a task; None if it is not finished."""
        return self.read_json(f"{_DONE}/{stage}/{index}.json")

    def finished(self, stage: str) -> set[int]:
        """The finished tasks of a stage."""
        folder = self.path / _DONE / stage
        names = os.listdir(folder) if folder.is_dir() else []
        return {
            int(name[: -len(".json")])
            for name in names
            if name.endswith(".json") and name[: -len(".json")].isdigit()
        }

    def results(self, stage: str) -> dict[int, Any]:
        """The results of the finished tasks of a stage."""
        return {index: self.result(stage, index) for index in sorted(self.finished(stage))}

    def finish_stage(self, stage: str, result: Any) -> None:
        """Record that a stage is reduced; the leader's ``finish``."""
        (self.path / _DONE / stage).mkdir(parents=True, exist_ok=True)
        self.write_json(f"{_DONE}/{stage}/{_REDUCED}", result)

    def stage_result(self, stage: str) -> Any:
        """What ``finish_stage`` recorded; None if the stage is not reduced."""
        return self.read_json(f"{_DONE}/{stage}/{_REDUCED}")

    def forget_stage(self, stage: str) -> None:
        """Remove the results of a stage, so that it is run again."""
        shutil.rmtree(self.path / _DONE / stage)

    def remove(self) -> None:
        """Remove the folder and all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)

    @property
    def free_bytes(self) -> int:
        """Bytes that are free where it lies."""
        folder = self.path
        while not folder.exists():
            folder = folder.parent
        return shutil.disk_usage(folder).free
