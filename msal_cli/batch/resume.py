"""Earlier runs: which outputs are current, proved by hashes and not by times, and the history of a
folder from its manifests."""

import hashlib
import json
import logging
import os
import platform
import stat
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path
from threading import Event
from typing import Any

from msal_cli.batch import manifest as manifests
from msal_cli.batch.lock import Shard, refuse_locked
from msal_cli.batch.manifest import FileStat, LogView, Manifest, ManifestEntry
from msal_cli.batch.plan import Plan, identify_file, manifest_key
from msal_cli.codecs.detection import format_of_name
from msal_cli.errors import OutputError, UsageError
from msal_cli.job.records import DONE, Failure, MeshRecord, MethodUsed, Run, from_data
from msal_cli.job.settings import SELF_INTERSECTIONS, Settings, Task
from msal_cli.light_dataclass import dataclass
from msal_cli.machine import iso_timestamp
from msal_cli.storage.atomic import write_whole
from msal_cli.storage.regular import open_regular
from msal_cli.storage.sidecars import list_carried
from msal_cli.storage.urls import ObjectMark, is_url
from msal_cli.version import __version__

# Failures that the file itself causes recur with the same file, settings and version.  All others
# (crashes, memory, timeouts, disks, missing packages) may not.
_FAULTS_OF_FILES = {"E_FORMAT", "E_TRUNCATED", "E_CONTENT", "E_NONFINITE", "E_INDEX", "E_NO_FACES"}
_FAULTS_OF_FILES |= {"E_RANGE", "E_LOSS"}

# Hashing is as fast as a disk; more threads than this only make the disk seek.
_MAX_THREADS = 8
_TASKS_PER_CALL = 32

_log = logging.getLogger("msal.batch")

OnDone = Callable[[int, MeshRecord], None]


def hash_settings(settings: Settings, members: Sequence[str] = ()) -> str:
    """SHA-256 of everything but the input that decides an output's bytes: settings, version, and
    the names of the ``members`` of a tile set, as canonical JSON."""
    data: dict[str, Any] = {"version": __version__, "settings": asdict(settings)}
    if members:
        data["members"] = list(members)
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), default=manifests.to_builtin)
    return hashlib.sha256(text.encode()).hexdigest()


def hash_file(path: str, is_stopped: Callable[[], bool] = lambda: False) -> str:
    """SHA-256 of a file; an empty string if it cannot be read or ``is_stopped`` became true."""
    digest = hashlib.sha256()
    try:
        with open_regular(path, buffering=0) as file:
            # Allocating a full block for each of many small files would cost more than hashing.
            block = bytearray(min(1 << 20, os.fstat(file.fileno()).st_size + 1))
            view = memoryview(block)
            while length := file.readinto(view):  # type: ignore[attr-defined]
                if is_stopped():
                    return ""
                digest.update(view[:length])
    except (OSError, ValueError):
        return ""
    return digest.hexdigest()


def is_same_file(
    path: str,
    then: FileStat | ObjectMark | None,
    sha256: str,
    is_stopped: Callable[[], bool] = lambda: False,
) -> bool:
    """Whether a file still has the size that it had ``then``, and this hash."""
    now = FileStat.of(path)
    if not sha256 or now is None or (isinstance(then, FileStat) and then.size != now.size):
        return False
    return hash_file(path, is_stopped) == sha256


@dataclass(frozen=True, slots=True)
class FileState:
    """What is to be done about one task.

    ``record`` is set if nothing is to be done: the output is current, or it is known that the file
    fails.  ``obstacle`` is a backup because of which the whole run must be refused.  With
    ``restores`` the input must first be restored from its backup, because a run was killed right
    after it replaced the input.
    """

    index: int
    record: MeshRecord | None = None
    obstacle: str = ""
    restores: bool = False


def file_states(
    plan: Plan, by_place: Mapping[str, Manifest], settings: set[str], *, threads: int
) -> Generator[FileState, None, None]:
    """The state of every task, in the plan's order, by the manifest of each place and the hashes of
    ``settings`` any of which will do.

    An output is current if input, output, settings and version match the manifest: files are read
    and hashed, their times are never trusted.  Closing the iterator stops the reading.
    """
    is_stopped = Event()
    check = _FreshnessCheck(plan, by_place, settings, is_stopped)
    indices = range(len(plan.tasks))
    n_read = sum(plan.tasks[index].in_place or check.entry(index) is not None for index in indices)
    if n_read < 2 or threads < 2:
        yield from map(check.file_state, indices)
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(min(threads, _MAX_THREADS, n_read))
    try:
        # Handing files over one by one would take longer than hashing small ones.
        shares = [indices[at : at + _TASKS_PER_CALL] for at in indices[::_TASKS_PER_CALL]]
        for states in pool.map(lambda share: list(map(check.file_state, share)), shares):
            yield from states
    finally:
        is_stopped.set()
        pool.shutdown(wait=True, cancel_futures=True)


class _FreshnessCheck:
    def __init__(
        self, plan: Plan, by_place: Mapping[str, Manifest], settings: set[str], is_stopped: Event
    ) -> None:
        self.plan, self.by_place, self.settings = plan, by_place, settings
        self.is_stopped = is_stopped
        self._methods: dict[str, MethodUsed] = {}
        self._manifests = {os.path.realpath(place): known for place, known in by_place.items()}

    def entry(self, index: int) -> ManifestEntry | None:
        """The manifest entry of a task; in place the newest one of any folder above the file."""
        task = self.plan.tasks[index]
        place = task.manifest_dir
        if place is None or not task.in_place:
            return None if place is None else self.by_place[place].get(manifest_key(task))
        path = Path(os.path.realpath(task.output))
        folders = [(str(folder), len(str(folder).rstrip(os.sep)) + 1) for folder in path.parents]
        found = (self._manifest(name).get(path.as_posix()[start:]) for name, start in folders)
        return max(filter(None, found), key=lambda entry: (entry.at, entry.is_done), default=None)

    def _manifest(self, folder: str) -> Manifest:
        if folder not in self._manifests:
            try:
                self._manifests[folder] = manifests.open_manifest(folder)
            except OutputError:  # perhaps another user's
                self._manifests[folder] = Manifest(folder, ())
        return self._manifests[folder]

    def file_state(self, index: int) -> FileState:
        task, entry = self.plan.tasks[index], self.entry(index)
        if entry is not None and entry.is_done and not self.plan.fresh:
            is_repeated = entry.settings in self.settings
            if record := self._known_result(task, entry) if is_repeated else None:
                return FileState(index, record=record)
        return self._in_place_state(index, task, entry) if task.in_place else FileState(index)

    def _known_result(self, task: Task, entry: ManifestEntry) -> MeshRecord | None:
        """The record of an output that is current, or of a failure that would recur; else None."""
        if entry.status in DONE:
            is_current = self._is_same(task.output, entry.output_version, entry.output_sha256)
            if not is_current or not (task.in_place or self._is_same_input(task, entry)):
                return None
            record = entry.record() or MeshRecord(input=task.input, status="up-to-date")
            if _lost_beside(record, task.input, task.output, self.is_stopped.is_set):
                return None
            method = record.method
            return replace(
                record,
                input=task.input,
                output=task.output,
                status="up-to-date",
                # Share the text of the entry.
                input_sha256=entry.input_sha256 or record.input_sha256,
                output_sha256=entry.output_sha256 or record.output_sha256,
                # Share equal methods: thousands of copies would need much memory.
                method=method and self._methods.setdefault(repr(method), method),
            )
        if self.plan.retry_failed or entry.status != "failed":
            return None
        failed = entry.record()
        if failed is None or failed.error is None or failed.error.code not in _FAULTS_OF_FILES:
            return None
        if not self._is_same_input(task, entry):
            return None
        return replace(failed, input=task.input, output=None, remembered=True)

    def _is_same_input(self, task: Task, entry: ManifestEntry) -> bool:
        if format_of_name(task.input) == "gltf":
            return False  # its mesh may be in another file, of which the manifest knows nothing
        return self._is_same(
            task.input, entry.input_version, entry.input_sha256, now=task.input_mark
        )

    def _is_same(
        self,
        path: str,
        then: FileStat | ObjectMark | None,
        sha256: str,
        now: ObjectMark | None = None,
    ) -> bool:
        """Whether a file or object is as it was ``then``; ``now`` is its mark from a listing."""
        if is_url(path):
            now = now or self.plan.objects.get(path)
            # Without a tag, an object of the same size may have other bytes.
            return now is not None and now == then and bool(now.tag)
        return is_same_file(path, then, sha256, self.is_stopped.is_set)

    def _hash(self, path: str) -> str:
        return hash_file(path, self.is_stopped.is_set)

    def _in_place_state(self, index: int, task: Task, entry: ManifestEntry | None) -> FileState:
        original = entry.input_version if entry is not None else None
        was_interrupted = entry is not None and not entry.is_done
        now = FileStat.of(task.input)
        if not task.backup:
            if not was_interrupted or self.plan.fresh or now == original:
                return FileState(index)
            failure = Failure(
                "E_CHANGED",
                "the file changed since a run in place was interrupted; it may be denoised already",
                hint="look at it, and give --fresh to denoise it as it is now",
            )
            return FileState(index, MeshRecord(input=task.input, status="failed", error=failure))
        backup = task.backup_path
        if not os.path.lexists(backup):
            return FileState(index)
        if not stat.S_ISREG(os.lstat(backup).st_mode):
            # Restoring from a link would replace the input by the target of the link.
            return FileState(index, obstacle=backup)
        kept = FileStat.of(backup)
        sizes_differ = kept is not None and (now is None or kept.size != now.size)
        if not sizes_differ and self._hash(backup) == self._hash(task.input) != "":
            return FileState(index)
        if was_interrupted and kept and original and kept.size == original.size:
            return FileState(index, restores=True)
        return FileState(index, obstacle=backup)


class Journal:
    """The manifests of all places of a plan, read for earlier runs and appended to by this one."""

    def __init__(self, plan: Plan, settings: Settings, cores: int) -> None:
        self._plan, self._settings, self._cores = plan, settings, cores
        members = [task.relative for task in plan.tasks] if plan.is_set else []
        if not any(format_of_name(task.input) == "3mf" for task in plan.tasks):
            settings = replace(settings, unit=None)  # only 3MF files have one to compare it with
        self._hash = hash_settings(settings, members)
        # A record with more counts than are wanted will do.
        counted = hash_settings(replace(settings, checks=(SELF_INTERSECTIONS,)), members)
        self._hashes = {self._hash, counted}
        self.manifests: dict[str, Manifest] = {}
        self._started_s = time.monotonic()
        # The manifests in which the start of this run is recorded.
        self._begun: list[Manifest] = []
        self._stats: dict[int, FileStat | None] = {}

    def read(self) -> None:
        """Read the manifests; nothing is locked or changed."""
        self.manifests = {place: manifests.open_manifest(place) for place in self._plan.folders()}

    def begin(
        self,
        stack: ExitStack,
        opened: Mapping[str, Manifest],
        command: tuple[str, ...],
        on_done: OnDone,
    ) -> list[int]:
        """Lock all places but those ``opened``, pass what is up to date to ``on_done``, and record
        the start of this run; return the indices of the tasks to do.

        ``stack`` releases locks and manifests.
        """
        tasks = self._plan.tasks
        shard = self._plan.shard
        start = {
            "kind": "run",
            "format": manifests.FORMAT,
            "command": list(command),
            "shard": shard and [shard.number, shard.count],
            "version": __version__,
            "settings": asdict(self._settings),
            "started": iso_timestamp(time.time_ns()),
            "pid": os.getpid(),
            "host": platform.node(),
            "files": len(tasks),
        }
        for place in self._plan.folders():
            self.manifests[place] = opened.get(place) or manifests.open_folder(place, stack, shard)
        # A run in place locks the folder that was named, and its files may be those of another run,
        # on a folder above or within it.
        in_place = {os.path.dirname(os.path.realpath(t.output)) for t in tasks if t.in_place}
        above = {str(path) for name in in_place for path in (Path(name), *Path(name).parents)}
        refuse_locked(sorted(above - set(map(os.path.realpath, self.manifests))))
        todo, restored = self.find_outdated(on_done)
        for manifest in self.manifests.values():
            manifest.open()
            manifest.append([start])
            self._begun.append(manifest)
        for index in restored:
            restore_backup(tasks[index])
        self._append(
            todo,
            lambda index, key: manifests.intent_line(key, tasks[index].input, tasks[index].output),
        )
        self._stats = {n: FileStat.of(tasks[n].input) for n in todo if tasks[n].in_place}
        return todo

    def find_outdated(self, on_done: OnDone) -> tuple[list[int], list[int]]:
        """The indices of the tasks to do, and of those among them whose inputs must first be
        restored from backups; the records of the other tasks go to ``on_done``."""
        todo: list[int] = []
        restored: list[int] = []
        obstacles: list[str] = []
        checks = file_states(self._plan, self.manifests, self._hashes, threads=self._cores)
        with closing(checks):
            states: Iterable[FileState] = checks
            if self._plan.is_set:
                # If one file is to be denoised, all are.
                states = list(checks)
                if any(state.record is None for state in states):
                    states = [FileState(state.index) for state in states]
            for state in states:
                if state.obstacle:
                    obstacles.append(state.obstacle)
                elif state.record is not None:
                    on_done(state.index, state.record)
                else:
                    todo.append(state.index)
                    restored += [state.index] if state.restores else []
        if obstacles:
            more = f" and {len(obstacles) - 1:,} more" if len(obstacles) > 1 else ""
            raise UsageError(
                f"a backup exists that is not the file to be replaced: {obstacles[0]!r}{more}",
                hint="the original is in it: move it back, or choose another --backup suffix",
                path=obstacles[0],
            )
        self._warn_of_replaced_outputs(todo)
        return todo, restored

    def _warn_of_replaced_outputs(self, todo: Sequence[int]) -> None:
        """Warn of outputs, made from other inputs that still exist, which this run replaces."""
        replaced = []
        for task in (self._plan.tasks[index] for index in todo):
            place = task.manifest_dir
            entry = None if place is None else self.manifests[place].get(manifest_key(task))
            if entry is None or entry.status not in DONE or identify_file(task.output) is None:
                continue
            source = str(entry.data().get("paths", [""])[0])
            if identify_file(source) not in (None, identify_file(task.input)):
                replaced.append(f"{task.output!r}, which was made of {source!r}")
        if replaced:
            more = f" (and {len(replaced) - 1:,} more like it)" if len(replaced) > 1 else ""
            advice = "give each input folder an output folder of its own to keep both"
            _log.warning("this replaces %s%s; %s", replaced[0], more, advice)

    def note_done(self, finished: Mapping[int, MeshRecord]) -> None:
        """Record finished files; OutputError if that fails."""
        tasks = self._plan.tasks
        self._append(
            finished,
            lambda index, key: manifests.done_line(
                key, self._hash, finished[index], tasks[index].input, tasks[index].output
            ),
        )

    def end(self, *, interrupted: bool) -> None:
        """Record the end of this run wherever its start is recorded."""
        line = {
            "kind": "end",
            "format": manifests.FORMAT,
            "finished": iso_timestamp(time.time_ns()),
            "seconds": round(time.monotonic() - self._started_s, 3),
            "interrupted": interrupted,
        }
        for manifest in self._begun:
            manifest.append([line])

    def roll_back(self, index: int) -> str:
        return roll_back(self._plan.tasks[index], self._stats.get(index))

    def _append(self, indices: Iterable[int], line: Callable[[int, str], dict[str, Any]]) -> None:
        lines: dict[str, list[dict[str, Any]]] = {}
        for index in indices:
            task = self._plan.tasks[index]
            if task.manifest_dir is not None:
                lines.setdefault(task.manifest_dir, []).append(line(index, manifest_key(task)))
        for place, new_lines in lines.items():
            self.manifests[place].append(new_lines)


def restore_backup(task: Task) -> None:
    """Restore the original from its backup, whole or not at all; OutputError if that fails."""
    backup = task.backup_path
    try:
        with open_regular(backup) as file:
            write_whole(task.input, [file.read()], sources=[backup])
    except (OSError, OutputError) as error:
        reason = str(error).partition(": ")[2] or str(error)
        raise OutputError(
            f"{task.input!r} cannot be restored from its backup: {reason}", path=task.input
        ) from None


def roll_back(task: Task, before: FileStat | None) -> str:
    """Undo what a lost worker may have done to a file in place, which must never be denoised twice.

    A replaced file is restored from its backup.  Without a backup, a file whose stat is no longer
    ``before`` may be denoised already.  Returns the reason why the task must not be tried again,
    or an empty string.
    """
    if not task.in_place:
        return ""
    if task.backup:
        backup = task.backup_path
        is_file = os.path.isfile(backup) and not os.path.islink(backup)
        if is_file and hash_file(backup) not in ("", hash_file(task.input)):
            try:
                restore_backup(task)
            except OutputError as error:
                return error.message
        return ""
    if FileStat.of(task.input) == before:
        return ""
    return "the file changed before its worker was lost, and may be denoised already"


# Runs and files, as manifests describe them


@dataclass(frozen=True)
class RunEntry(Run):
    """A run as its manifest describes it; ``at`` orders runs (see `manifest`).

    A run without an end line was killed or is still running: it is ``interrupted``, and finished
    when it wrote its last line.
    """

    shard: Shard | None = None
    at: int = 0

    @property
    def configuration(self) -> tuple[str, str]:
        """Version and settings; they are equal for runs that did the same work."""
        return self.version, json.dumps(self.settings, sort_keys=True, default=repr)


@dataclass(frozen=True)
class FileRow:
    """One file in a manifest: its record, and when that was made (``at``, see `manifest`).

    ``input`` is the path of that run, and ``output`` where its output is now: below the folder of
    the manifest.  In a report both are paths of that run, and a failure has no output.
    """

    at: int
    input: str
    output: str
    record: MeshRecord


RunHistory = tuple[list[RunEntry], list[FileRow]]
"""All runs in some manifests, oldest first, and the newest row of every file."""


def read_history(views: Sequence[LogView], place: str) -> RunHistory:
    """Parse the manifests of a place; a file that no run finished has a ``planned`` record."""
    runs = [run for view in views for run in _parse_runs(view)]
    rows = []
    for entry in manifests.merge_entries(views).values():
        record = entry.record() if entry.is_done else None
        try:
            source, target = map(str, entry.data()["paths"])
        except (KeyError, TypeError, ValueError):
            source, target = entry.name, ""
        here = target if is_url(target) else os.path.abspath(os.path.join(place, entry.name))
        if record is None:
            record = MeshRecord(input=source, status="planned", output=target or here)
        rows.append(FileRow(entry.at, source, here, record))
    return sorted(runs, key=lambda run: run.at), rows


def list_lost(views: Sequence[LogView], folder: str) -> list[str]:
    """The outputs in a folder, and files beside them that belong to them, that are missing, or
    changed since they were written."""
    entries = manifests.merge_entries(views).values()
    lost = []
    for entry in (entry for entry in entries if entry.status in DONE):
        path, record = os.path.join(folder, entry.name), entry.record()
        if not is_same_file(path, entry.output_version, entry.output_sha256):
            lost.append(path)
        lost += [] if record is None else _lost_beside(record, record.input, path)
    return list(dict.fromkeys(lost))


def _lost_beside(
    record: MeshRecord, source: str, output: str, is_stopped: Callable[[], bool] = lambda: False
) -> list[str]:
    """The files beside an output that belong to it and are missing or, where their hash is known,
    changed; none in a store."""
    if is_url(output):
        return []
    known = list_carried(record.sidecars, source, output)
    if (fields := record.fields) is not None:
        path = os.path.join(os.path.dirname(output), os.path.basename(fields.path))
        known.append((path, fields.sha256))
    return [
        path
        for path, sha256 in known
        if not os.path.exists(path) or (sha256 and hash_file(path, is_stopped) != sha256)
    ]


def _parse_runs(view: LogView) -> list[RunEntry]:
    runs: list[RunEntry] = []
    for run_line in view.run_lines:
        try:
            data = json.loads(run_line.line)
            if data["kind"] == "run":
                shard, at, last_at = data["shard"], int(data["at"]), run_line.last_at
                # Until its end line is read, as if it had ended with its last entry.
                end = {
                    "finished": iso_timestamp(last_at) if last_at > at else data["started"],
                    "seconds": max(0, last_at - at) / 1e9,
                    "interrupted": True,
                }
                shard = shard and {"number": shard[0], "count": shard[1]}
                runs.append(from_data(RunEntry, {**data, **end, "shard": shard}))
            elif runs:
                runs[-1] = replace(
                    runs[-1],
                    finished=str(data["finished"]),
                    seconds=float(data["seconds"]),
                    interrupted=bool(data["interrupted"]),
                )
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    return runs
