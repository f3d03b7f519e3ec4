"""What an earlier run has done already, proved by hashes and not by times."""

from __future__ import annotations

import contextlib
import os
import stat
import threading
from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from msal_cli.batch.manifest import Entry, FileMark, Manifest, file_sha256
from msal_cli.batch.plan import Plan
from msal_cli.batch.temporary_files import temporary_name
from msal_cli.errors import OutputError
from msal_cli.job.records import DONE, Failure, MeshRecord, MethodUsed, ObjectMark
from msal_cli.job.settings import Task, suffix
from msal_cli.storage.urls import is_url

# What a file brings on itself comes again with the same file, settings and version.  All other
# failures (crashes, memory, time, disks, what is not installed) may go away by themselves.
_FAULTS_OF_FILES = frozenset(
    {
        "E_FORMAT",
        "E_TRUNCATED",
        "E_CONTENT",
        "E_NONFINITE",
        "E_INDEX",
        "E_NO_FACES",
        "E_RANGE",
        "E_LOSS",
    }
)

# Hashing is as fast as a disk; more threads than this only make the disk seek.
_MOST_THREADS = 8
_SHARE = 32


@dataclass(frozen=True, slots=True)
class Standing:
    """What is to be done about one task.

    ``record`` is set if there is nothing to do: the output is current, or the file cannot be done,
    as may be known from an earlier run.
    ``objection`` is a reason to refuse the whole run.  With ``restores`` the input is first to be
    put back from its backup, because a run was killed right after it replaced it.
    """

    index: int
    record: MeshRecord | None = None
    objection: str = ""
    restores: bool = False


def standings(
    plan: Plan, manifests: Mapping[str, Manifest], settings: str, *, threads: int
) -> Generator[Standing, None, None]:
    """The standing of every task, in the plan's order; ``settings`` is their hash.

    An output is current if input, output, settings and version are those of the manifest: files
    are read and hashed, their times are never trusted.  Closing the iterator stops the reading.
    """
    is_stopped = threading.Event()
    judge = _Judge(plan, manifests, settings, is_stopped)
    known = [index for index in range(len(plan.tasks)) if judge.needs_reading(index)]
    if len(known) < 2 or threads < 2:
        yield from map(judge.standing, range(len(plan.tasks)))
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(min(threads, _MOST_THREADS, len(known)))
    try:
        # A hand-over of each file by itself would take longer than the hashing of a small one.
        shares = [
            range(len(plan.tasks))[at : at + _SHARE] for at in range(0, len(plan.tasks), _SHARE)
        ]
        for some in pool.map(lambda share: list(map(judge.standing, share)), shares):
            yield from some
    finally:
        is_stopped.set()
        pool.shutdown(wait=True, cancel_futures=True)


class _Judge:
    def __init__(
        self,
        plan: Plan,
        manifests: Mapping[str, Manifest],
        settings: str,
        is_stopped: threading.Event,
    ) -> None:
        self._plan = plan
        self._manifests = manifests
        self._settings = settings
        self._is_stopped = is_stopped
        self._methods: dict[str, MethodUsed] = {}

    def _entry(self, index: int) -> Entry | None:
        home = self._plan.homes[index]
        return None if home is None else self._manifests[home].get(self._plan.key(index))

    def needs_reading(self, index: int) -> bool:
        return self._entry(index) is not None or self._plan.tasks[index].in_place

    def standing(self, index: int) -> Standing:
        task, entry = self._plan.tasks[index], self._entry(index)
        if entry is not None and not self._plan.fresh:
            if self._is_current(task, entry):
                record = _up_to_date(task, entry)
                return Standing(index, record=replace(record, method=self._shared(record.method)))
            if failed := self._failed_before(task, entry):
                return Standing(index, record=failed)
        return self._in_place_standing(index, task, entry) if task.in_place else Standing(index)

    def _shared(self, method: MethodUsed | None) -> MethodUsed | None:
        """The first of equal ones: thousands of copies would be much memory."""
        return None if method is None else self._methods.setdefault(repr(method), method)

    def _is_current(self, task: Task, entry: Entry) -> bool:
        if not entry.is_done or entry.settings != self._settings:
            return False
        if entry.status not in DONE:
            return False
        if is_url(task.output):
            there = self._plan.objects.get(task.output)
            if not _is_same_object(there, entry.output_object):
                return False
        elif not self._is_same(task.output, entry.output_mark, entry.output_sha256):
            return False
        return task.in_place or self._is_same_input(task, entry)

    def _failed_before(self, task: Task, entry: Entry) -> MeshRecord | None:
        """The record of a failure that would come again, because the file itself is at fault."""
        if self._plan.retry_failed or entry.status != "failed" or not entry.is_done:
            return None
        if entry.settings != self._settings:
            return None
        record = entry.record()
        if record is None or record.error is None or record.error.code not in _FAULTS_OF_FILES:
            return None
        if not self._is_same_input(task, entry):
            return None
        return replace(record, input=task.input, output=None, remembered=True)

    def _is_same_input(self, task: Task, entry: Entry) -> bool:
        if suffix(task.input) == ".gltf":
            return False  # its mesh may be in another file, of which the manifest knows nothing
        if is_url(task.input):
            return _is_same_object(task.input_mark, entry.input_object)
        return self._is_same(task.input, entry.input_mark, entry.input_sha256)

    def _is_same(self, path: str, mark: FileMark | None, sha256: str) -> bool:
        now = FileMark.of(path)
        if not sha256 or now is None or (mark is not None and mark.size != now.size):
            return False
        return self._sha256(path) == sha256

    def _sha256(self, path: str) -> str:
        return file_sha256(path, self._is_stopped.is_set)

    def _in_place_standing(self, index: int, task: Task, entry: Entry | None) -> Standing:
        was_interrupted = entry is not None and not entry.is_done
        if not task.backup:
            if (
                was_interrupted
                and not self._plan.fresh
                and FileMark.of(task.input) != (entry.input_mark if entry else None)
            ):
                return Standing(index, record=_maybe_done(task))
            return Standing(index)
        backup = backup_path(task)
        if not os.path.lexists(backup):
            return Standing(index)
        if not stat.S_ISREG(os.lstat(backup).st_mode):
            # What a link leads to would be put in the place of the input.
            return Standing(index, objection=str(backup))
        mark = FileMark.of(str(backup))
        sizes_differ = mark is not None and mark.size != _size(task.input)
        if not sizes_differ and self._sha256(str(backup)) == self._sha256(task.input) != "":
            return Standing(index)
        original = entry.input_mark if entry is not None else None
        if was_interrupted and mark and original and mark.size == original.size:
            return Standing(index, restores=True)
        return Standing(index, objection=str(backup))


def _is_same_object(now: ObjectMark | None, then: ObjectMark | None) -> bool:
    # Without a tag an object of the same size may be another.
    return now is not None and now == then and bool(now.tag)


def backup_path(task: Task) -> Path:
    """Where an in-place task keeps the original."""
    return Path(task.input + (task.backup or ""))


def restore(task: Task) -> None:
    """Put the original back from its backup, whole or not at all; OutputError if that fails."""
    import shutil

    target = Path(task.input)
    temporary = target.with_name(temporary_name("restored"))
    try:
        try:
            shutil.copyfile(backup_path(task), temporary)
            shutil.copymode(target, temporary)
            temporary.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise OutputError(
            f"{task.input!r} cannot be restored from its backup: {error.strerror}", path=task.input
        ) from None


def undone(task: Task, mark: FileMark | None) -> str:
    """Undo what a lost worker may have done to a file in place, which must never be denoised twice.

    A file that was replaced is put back from its backup.  Without one, a file that has not the
    ``mark`` that it had before the work began may be denoised already: the reason why it must not
    be tried again is returned, and otherwise an empty string.

    Raises
    ------
    OutputError
        if the original cannot be put back.
    """
    if not task.in_place:
        return ""
    if task.backup:
        backup = backup_path(task)
        is_file = os.path.isfile(backup) and not os.path.islink(backup)
        if is_file and file_sha256(str(backup)) not in ("", file_sha256(task.input)):
            restore(task)
        return ""
    if FileMark.of(task.input) == mark:
        return ""
    return "the file changed before its worker was lost, and may be denoised already"


def _size(path: str) -> int | None:
    mark = FileMark.of(path)
    return None if mark is None else mark.size


def _up_to_date(task: Task, entry: Entry) -> MeshRecord:
    earlier = entry.record() or MeshRecord(input=task.input, status="up-to-date")
    return replace(
        earlier,
        input=task.input,
        output=task.output,
        status="up-to-date",
        # The same text as in the entry, and not a copy.
        input_sha256=entry.input_sha256 or earlier.input_sha256,
        output_sha256=entry.output_sha256 or earlier.output_sha256,
    )


def _maybe_done(task: Task) -> MeshRecord:
    return MeshRecord(
        input=task.input,
        status="failed",
        error=Failure(
            "E_CHANGED",
            "the file changed since a run in place was interrupted; it may be denoised already",
            hint="look at it, and give --fresh to denoise it as it is now",
        ),
    )
