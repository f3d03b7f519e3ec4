"""The scratch folder of one run by tiles: large arrays in files, and the results of finished tasks.

Every array is a file of raw numbers that tasks map into memory for as long as they need it; tasks
write to ranges of their own.  The result of a task is a small JSON file that appears whole once all
that the task wrote is on the disk, so that a run that was killed goes on from finished tasks.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from msal_cli.storage.atomic import write_whole

_PLAN, _DONE, _TILES = "plan.json", "done", "tiles"


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

    def write_range(self, name: str, first_byte: int, values: Any) -> None:
        """Write numbers into a file that exists, without mapping it."""
        with open(self.path / name, "r+b", buffering=0) as file:
            file.seek(first_byte)
            view = np.ascontiguousarray(values).data.cast("B")
            while len(view):
                view = view[file.write(view) :]

    def tile_folder(self, tile: int) -> Path:
        """The folder of a tile's own files."""
        folder = self.path / _TILES / str(tile)
        folder.mkdir(parents=True, exist_ok=True)
        return folder

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

    def results(self, stage: str) -> dict[int, Any]:
        """The results of the finished tasks of a stage."""
        folder = self.path / _DONE / stage
        if not folder.is_dir():
            return {}
        return {
            int(one.stem): json.loads(one.read_bytes())
            for one in sorted(folder.iterdir())
            if one.suffix == ".json" and one.stem.isdigit()
        }

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
