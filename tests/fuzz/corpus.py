"""The corpus that fuzzing left: for each format the smallest files that reach all that was reached.

    tar -xf tests/fuzz/corpus/ply.tar.xz -C FOLDER             unpack, to go on from there
    python -m tests.fuzz.readers ply SMALLEST FOLDER FOUND -merge=1 --interpreted
    python -m tests.fuzz.corpus ply SMALLEST                   keep the result

Files are named by their SHA-1, as libFuzzer does; the archives are the same bytes on every run.
"""

from __future__ import annotations

import hashlib
import io
import sys
import tarfile
from pathlib import Path

FOLDER = Path(__file__).parent / "corpus"
LARGEST_FILE = 4096


def kept(format: str) -> dict[str, bytes]:
    """The files of a format by their names."""
    with tarfile.open(FOLDER / f"{format}.tar.xz") as archive:
        entries = [(entry.name, archive.extractfile(entry)) for entry in archive]
        return {name: file.read() for name, file in entries if file is not None}


def keep(format: str, folder: Path) -> int:
    """Keep the files of a folder as the corpus of a format; returns how many there are."""
    contents = {path.read_bytes() for path in folder.iterdir() if path.is_file()}
    found = {hashlib.sha1(data).hexdigest(): data for data in contents if len(data) <= LARGEST_FILE}
    FOLDER.mkdir(exist_ok=True)
    with tarfile.open(FOLDER / f"{format}.tar.xz", "w:xz", preset=9) as archive:
        # Neighbours that begin alike compress well.
        for name, data in sorted(found.items(), key=lambda item: item[1]):
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
    return len(found)


if __name__ == "__main__":
    print(keep(sys.argv[1], Path(sys.argv[2])), "files kept")
