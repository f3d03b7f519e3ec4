"""What the commands write and print, as sums made once and compared since.

    python -m tests.frozen.record_sums [NAME...]     names select commands, such as ``report``
    python -m tests.frozen.record_sums --list FOLDER  keep what is summed, one file each, to diff
    python -m tests.frozen.record_sums --write        replace the sums

Every command runs over copies of the sample meshes in a folder of its own.  There are two sums:
``data`` (exit codes, records, bytes of meshes, reports and manifests) and ``texts`` (messages,
reasons, hints, all that is printed for people).  Times, versions, the machine, memory and
process ids are left out.  To see what changed: ``--list A`` in an old checkout, ``--list B`` in
the new one, and ``diff -r A B``.
"""

import gzip
import itertools
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any
from unittest import mock

from click.testing import CliRunner

from msal_cli.cli import denoise, progress
from msal_cli.cli.main import program
from tests.frozen import kept
from tests.frozen.kept import ROOT, data_and_texts, digest
from tests.report.made import HOSTILE_NAMES

KEPT = Path(__file__).with_name("record_sums.json")

SMALL = ("toadstool_noisy.ply", "knot_noisy.stl", "bracket_noisy.ply")
PLY = "in/toadstool_noisy.ply"
BAD = "bad/bad.ply"
GATE = "abs(volume_change) > 0.0001%"

COMMANDS: dict[str, str] = {
    "plain": f"denoise {PLY} -o o/a.ply --method msal --json",
    "folder": "denoise in -o out --method msal -j 1 --json --report r.jsonl --report r.json",
    "again": "denoise in -o out --method msal -j 1 --json",
    "auto": f"denoise {PLY} in/knot_noisy.stl -o o2 --auto -j 1 --json",
    "default": f"denoise {PLY} -o o/d.ply --json",
    "summary": f"denoise {PLY} -o o/e.ply --auto",
    "keep": f"denoise {PLY} -o o/f.ply --auto --keep edges --strength 1 --json",
    "despike": f"denoise {PLY} -o o/g.ply --method msal --despike --json",
    "parameters": f"denoise {PLY} -o o/h.ply -n 2 -K 0.3 --schedule robust --mollify 1 --json",
    "constraints": "denoise in/bracket_noisy.ply -o o/i.ply --method msal --max-move 0.05e"
    " --lock boundary --json",
    "no property": f"denoise {PLY} -o o/j.ply --method msal --weights nothing --json",
    "min noise": f"denoise {PLY} -o o/k.ply --method msal --min-noise 0.9 --json",
    "fields": f"denoise {PLY} -o o/l.ply --method msal --fields displacement,noise --json",
    "reference": f"denoise {PLY} -o o/m.ply --method msal"
    " --reference clean/toadstool_clean.ply --json",
    "check": f"denoise {PLY} -o o/n.ply --method msal --check self-intersections --json",
    "in place": "denoise copies --in-place --method msal -j 1 --json",
    "no backup": "denoise copies/knot_noisy.stl --in-place --no-backup --method al --force --json",
    "gzip": "denoise packed/rock_noisy.ply.gz -o o/rock.ply.gz --method msal --json",
    "to": f"denoise {PLY} -o o3 --to obj --method msal --json",
    "strict": f"denoise {PLY} -o o4 --to stl --strict --method msal --json",
    "encoding": f"denoise {PLY} -o o/p.ply --encoding binary --precision float32"
    " --method msal --json",
    "dry run": "denoise in bad -o o5 --dry-run",
    "dry run json": "denoise in bad -o o5 --dry-run --json",
    "gate": f"denoise {PLY} -o o/q.ply --method msal --json --fail-on",
    "gate of failure": "denoise in bad -o o6 --method msal -j 1 --json --fail-on",
    "bad": f"denoise {BAD} -o o/r.ply --method msal --json",
    "bad in words": f"denoise {BAD} -o o/r.ply --method msal",
    "no file": "denoise nowhere.ply -o o/t.ply",
    "no method": f"denoise {PLY} -o o/t.ply --method nothing",
    "no option": f"denoise {PLY} --nothing",
    "no format": "denoise in/sub.xyz -o o/t.ply --json",
    "exists": f"denoise {PLY} -o clean/toadstool_clean.ply --method msal",
    "info": "info in packed bad --json",
    "info check": f"info {PLY} --json --check self-intersections",
    "info words": f"info {PLY} {BAD}",
    "compare": f"compare clean/toadstool_clean.ply {PLY} --json",
    "compare words": f"compare clean/toadstool_clean.ply {PLY} --heatmap o/heat.ply",
    "compare folders": "compare in out --json",
    "compare folders words": "compare in out",
    "compare gate": f"compare clean/toadstool_clean.ply {PLY} --json --fail-on",
    "compare bad": f"compare {BAD} {PLY}",
    "noise": "noise clean -o noisy",
    "noise impulsive": "noise clean/toadstool_clean.ply -o o/u.ply --kind impulsive --seed 3",
    "view": f"view {PLY} o/a.ply -o o/v.png --size 128",
    "page": f"view {PLY} o/a.ply -o o/v.html",
    "methods": "methods",
    "methods json": "methods --json",
    "methods msal": "methods msal",
    "report": "report out",
    "report verbose": "report out -v --fail-on",
    "report check": "report out r.jsonl --check --json",
    "report nothing": "report clean",
    "unknown command": "denoize",
    "version": "--version",
}
"""Command lines by name; where the last word is --fail-on, ``GATE`` follows."""

SUFFIXES = ("json", "jsonl", "csv", "md", "xml", "html")

DROPPED = re.compile(
    r"^at$|seconds|started|finished|version|machine|host|pid|memory|mtime|time_ns|inode|vertices_per"
)
"""Names of fields that are another at each run."""

WORDS = ("message", "hint", "where", "reason", "warnings", "words", "notes", "sidecars", "basis")
"""Names of fields that are for people."""

CHANGING = (
    (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|\+00:00)?", "TIME"),
    (r"\d+\.\d+\.\d+(?:\.?(?:dev|post|rc)\w*)?", "VERSION"),
    (r"(?m) +[\d,]+ +\d+\.\d\d(?=  |$)", "  RATE TIME"),
    # Where no face is flipped.
    (r" +\d+\.\d\d(?=  [a-z])", "  TIME"),
    (r" {2,}", "  "),
    (r"(?m)^.*(?:vertices/s|time  |files? in ).*$", "TIMES"),
    (r"\b(?:\d+ min )?\d[\d,]*(?:\.\d+)? (?:s|ms|seconds|MB|GB)\b", "AMOUNT"),
)
"""What is another at each run in texts for people, and what stands for it."""


def without(value: Any, dropped: re.Pattern[str], texts: list[str]) -> Any:
    """JSON data without fields that change; texts for people go to ``texts``."""
    if isinstance(value, dict):
        kept = {}
        for name, inner in value.items():
            if name in WORDS:
                texts.append(f"{name}: {json.dumps(inner)}")
                kept[name] = len(inner) if isinstance(inner, list) else inner is not None
            elif not dropped.search(name):
                kept[name] = without(inner, dropped, texts)
        return kept
    return [without(inner, dropped, texts) for inner in value] if isinstance(value, list) else value


def still(text: str, folder: str) -> str:
    """A text for people without times and places."""
    text = text.replace(folder, "FOLDER").replace(str(ROOT), "ROOT")
    for pattern, word in CHANGING:
        text = re.sub(pattern, word, text)
    return text


def split(data: bytes, name: str, folder: str) -> tuple[str, str]:
    """Data and texts of a file or of what was printed."""
    if name.endswith(".gz"):
        data = gzip.decompress(data)
    if not name.endswith((".json", ".jsonl", ".csv", ".md", ".xml", ".html", ".txt", "stdout")):
        return digest(data), ""
    text = data.decode("utf-8", "replace")
    try:
        whole = [json.loads(text)]
    except ValueError:
        try:
            whole = [json.loads(line) for line in text.splitlines()]
        except ValueError:
            return "", still(text, folder)
    texts: list[str] = []
    kept = json.dumps([without(document, DROPPED, texts) for document in whole], indent=1)
    return still(kept, folder), still("\n".join(texts), folder)


def files_of(folder: Path) -> dict[str, tuple[int, int]]:
    """All files and when they were written."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != ".msal-lock":
            stat = path.stat()
            found[str(path.relative_to(folder))] = (stat.st_mtime_ns, stat.st_ino)
    return found


def run(words: list[str], folder: Path) -> tuple[str, str]:
    """Data and texts of one command line: what it printed, and every file that it wrote."""
    before = files_of(folder)
    made = CliRunner().invoke(program, words)
    data, texts = split(made.stdout_bytes, "stdout", str(folder))
    parts = [f"exit {made.exit_code}", data]
    printed = [texts, still(made.stderr, str(folder))]
    for name, stamp in files_of(folder).items():
        if before.get(name) != stamp:
            data, texts = split((folder / name).read_bytes(), name, str(folder))
            parts.append(f"{name}: {data}")
            printed.append(f"{name}: {texts}")
    return "\n".join(parts) + "\n", "\n".join(printed) + "\n"


def prepare(folder: Path) -> None:
    """The inputs of all commands."""
    samples = ROOT / "sample_meshes"
    for place in ("in", "copies"):
        (folder / place).mkdir()
        for name in SMALL:
            shutil.copy(samples / name, folder / place)
    for place, names in (("clean", ["toadstool_clean.ply"]), ("packed", ["rock_noisy.ply.gz"])):
        (folder / place).mkdir()
        for name in names:
            shutil.copy(samples / name, folder / place)
    (folder / "bad").mkdir()
    (folder / "o").mkdir()
    data = (samples / SMALL[0]).read_bytes()
    (folder / BAD).write_bytes(data[: len(data) // 2])
    (folder / "bad/empty.stl").write_bytes(b"")
    (folder / "bad/words.obj").write_bytes(b"v 1 2 nothing\nf 1 1 1\n")


def stored(document: dict[str, Any]) -> dict[str, Any]:
    """A report whose figures of time are fixed, with hostile names among its records."""
    document |= {"started": "2026-01-02T03:04:05.678Z", "finished": "2026-01-02T03:04:15.678Z"}
    document |= {"seconds": 10.0, "machine": {"system": "Linux", "cores": "2 of 2"}}
    for record in document["records"]:
        if record.get("seconds"):
            record["seconds"] = dict.fromkeys(record["seconds"], 0.5)
        for name in record:
            if re.search("per_second|memory", name) and record[name] is not None:
                record[name] = 1000
    example = document["records"][0]
    document["records"] += [
        example | {"input": name, "output": f"out/{name}"} for name in HOSTILE_NAMES
    ]
    return document


def outcomes(chosen: list[str]) -> Iterator[tuple[str, str, str]]:
    """Name, data and texts of every command that is chosen, or of all.

    Later commands read what earlier ones wrote: all run, whichever are chosen.
    """
    clock = mock.Mock(perf_counter=itertools.count(0.0).__next__)
    with (
        mock.patch.object(denoise, "iso_timestamp", lambda ns: "2026-01-02T03:04:05.678Z"),
        mock.patch.object(denoise, "time", clock),
        # On a busy machine a file may take long enough for its stage to be printed.
        mock.patch.object(progress, "_SILENT_S", float("inf")),
        mock.patch.object(denoise, "describe_machine", lambda: {"system": "Linux"}),
        mock.patch.dict(os.environ, COLUMNS="100", NO_COLOR="1", TERM="dumb"),
    ):
        yield from _outcomes(chosen)


def _outcomes(chosen: list[str]) -> Iterator[tuple[str, str, str]]:
    def is_chosen(name: str) -> bool:
        return not chosen or any(word in name for word in chosen)

    needed = {"plain", "folder"}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place).resolve()
        prepare(folder)
        with chdir(folder):
            for name, line in COMMANDS.items():
                if is_chosen(name) or name in needed:
                    words = line.split() + ([GATE] if line.endswith("--fail-on") else [])
                    yield name, *run(words, folder)
            if is_chosen("stored"):
                document = json.loads((folder / "r.json").read_bytes())
                (folder / "stored.json").write_text(json.dumps(stored(document)))
                for suffix in SUFFIXES:
                    target = folder / f"again.{suffix}"
                    CliRunner().invoke(program, ["report", "stored.json", "-o", target.name])
                    # Each byte of a report counts, as there are no times in it.
                    text = target.read_bytes().decode("utf-8", "surrogateescape")
                    yield f"stored {suffix}", "", text.replace(str(folder), "FOLDER")
                printed = CliRunner().invoke(program, ["report", "stored.json", "-v"]).stdout
                yield "stored text", "", printed
                yield "stored gates", *run(["report", "stored.json", "--fail-on", GATE], folder)


def sums(names: list[str], folder: Path | None) -> Iterator[tuple[str, list[str]]]:
    """The pairs of sums of commands; what is summed goes to files in a folder."""
    for name, data, texts in outcomes(names):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            for part, suffix in ((data, "data"), (texts, "texts")):
                path = folder / f"{name.replace(' ', '_')}.{suffix}"
                path.write_text(part, errors="surrogateescape")
        yield name, data_and_texts([data], [texts])


if __name__ == "__main__":
    parser = kept.options(str(__doc__))
    parser.add_argument("--list", metavar="FOLDER", type=Path)
    given = parser.parse_args()
    found = sums(given.names, given.list and given.list.resolve())
    kept.settle(KEPT, found, kept.environment("meshio", "trimesh"), given)
