"""Work for worker processes to do, and to die of.

A fake mesh file is text; a line ``die <how> [once]`` in it is an order to the worker that reads
it, where ``once`` leaves a mark beside the file and spares whoever comes second.  ``hang`` is
always once.
"""

import contextlib
import ctypes
import hashlib
import os
import signal
import sys
import time
from pathlib import Path

from msal_cli.batch.schedule import Failed, Interrupt, Returned, Started, Work
from msal_cli.batch.workers import WorkerPool
from msal_cli.job.records import Failure, MeshRecord
from msal_cli.storage.atomic import temporary_name, write_whole

DEATHS = {
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "segfault": lambda: ctypes.string_at(0),
    "exit": lambda: os._exit(3),
    "abort": os.abort,
    # The process that supervises this one.
    "parent": lambda: (os.kill(os.getppid(), signal.SIGKILL), time.sleep(60)),
}


def die(how):
    if how in DEATHS:
        DEATHS[how]()
    elif how == "memory":
        raise MemoryError
    elif how == "sysexit":
        sys.exit(1)
    elif how == "error":
        raise ValueError("a defect")
    raise AssertionError(how)


def pool(tasks, **options):
    """A pool for tasks of `work`, two at once if nothing else is said."""
    tasks = tasks if isinstance(tasks, dict) else dict(enumerate(tasks))
    options = {"jobs": 2, "cores": 2, "common": None} | options
    return WorkerPool(Work(tasks, work, **options))


def heard(some):
    return [message for batch in some.batches() for message in batch]


def results(messages):
    return {one.index: one.result for one in messages if isinstance(one, Returned)}


def lost(messages):
    return {one.index: one for one in messages if isinstance(one, Failed)}


class InProcess:
    """An engine that does one task after the other in this process."""

    def __init__(self, work):
        self._work, self._is_stopped, self._is_interrupted = work, False, False

    def batches(self):
        for index, task in self._work.tasks.items():
            if self._is_interrupted:
                raise Interrupt
            if self._is_stopped:
                return
            yield [Started(index)]
            try:
                result = self._work.function(task, self._work.common, lambda *step: None)
            except Exception as error:
                yield [Failed(index, Failure("E_INTERNAL", str(error)))]
            else:
                yield [Returned(index, result)]

    def stop(self):
        self._is_stopped = True

    def interrupt(self):
        self._is_interrupted = True


def work(task, common, on_progress):
    """The work of a `pool`: ``task`` is (action, argument)."""
    action, argument = task
    answers = {
        "double": lambda: 2 * argument,
        "common": lambda: common,
        "pid": os.getpid,
        "threads": lambda: os.environ["MSAL_THREADS"],
        "unpicklable": lambda: lambda: None,
    }
    if action in answers:
        return answers[action]()
    if action == "sleep":
        time.sleep(argument)
        return argument
    if action == "present":
        (Path(argument) / str(os.getpid())).touch()
        time.sleep(0.05)
        return None
    if action == "progress":
        for done in range(argument + 1):
            on_progress("sweeps", done, argument)
        return argument
    if action == "chatter":
        print("x" * argument)
        os.write(1, b"y" * argument + b"\n")
        os.write(2, b"z" * argument + b"\n")
        return sys.stdin.read()
    if action == "grow":
        HOARD.append(bytearray(os.urandom(1)) * argument)
        return os.getpid()
    if action == "hold":
        HOARD.append(b"x" * argument)
        time.sleep(60)
    if action == "bad_alloc":
        os.write(2, b"terminate called after throwing an instance of 'std::bad_alloc'\n")
        os.abort()
    if action == "alone":
        # How many workers of this run are alive while this one works, and had it another task?
        mark = Path(argument) / str(os.getpid())
        was_here = mark.exists()
        mark.touch()
        time.sleep(0.2)
        names = [int(one.name) for one in Path(argument).iterdir() if one.name.isdigit()]
        alive = sum(is_running(pid) for pid in names)
        first = not (Path(argument) / "tried").exists()
        (Path(argument) / "tried").touch()
        if first:
            die("kill")
        return alive, was_here
    die(action)
    return None


HOARD = []


def living_processes():
    """The process, its parent and its session (numbers) of each that is alive, by /proc."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent, _, session = path.read_text().rpartition(")")[2].split()[:4]
            if state not in "ZX":
                yield int(path.parent.name), int(parent), int(session)


def is_running(pid):
    return any(pid == living for living, *_ in living_processes())


def are_gone(pids, within_s=2.0):
    """Wait for the end of processes; whether all have ended by then."""
    deadline = time.monotonic() + within_s
    while any(map(is_running, pids)) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not any(map(is_running, pids))


def denoise(task, settings, on_progress=None, limits=None):
    """In the place of ``pipeline.denoise_file``: upper case for lower, and deaths to order."""
    data = Path(task.input).read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()

    def fail(code, input_sha256=None):
        error = Failure(code, "made to fail")
        return MeshRecord(task.input, "failed", input_sha256=input_sha256, error=error)

    for line in data.decode().splitlines():
        if line.startswith("sleep "):
            time.sleep(float(line.split()[1]))
        if line.startswith("after "):
            while not Path(task.output).with_name(line.split()[1]).exists():
                time.sleep(0.01)
        if line.startswith("hang"):
            mark = Path(task.input + ".hung")
            if not mark.exists():
                mark.touch()
                time.sleep(60)
        if line.startswith("fail"):
            # "fail" alone is a file that could not be read: nothing is known of its content.
            return fail((line.split() + ["E_FORMAT"])[1], sha256 if line != "fail" else None)
        if line.startswith("memory"):
            return fail("E_MEMORY")
        if line.startswith("die "):
            how, *once = line.split()[1:]
            mark = Path(task.input + ".died")
            if not (once and mark.exists()):
                mark.touch()
                if how == "midway":
                    half = Path(task.output).parent / temporary_name("half")
                    half.parent.mkdir(parents=True, exist_ok=True)
                    half.write_bytes(data[:3])
                    how = "kill"
                die(how)
    if on_progress is not None:
        on_progress("write", 1, 1)
    if task.in_place and task.backup:
        Path(task.input + task.backup).write_bytes(data)
    output = (settings.method + " " + data.decode().upper()).encode()
    Path(task.output).parent.mkdir(parents=True, exist_ok=True)
    write_whole(task.output, output)
    if data.startswith(b"replaced"):
        mark = Path(task.input + ".died")
        if b"always" in data or not mark.exists():
            mark.touch()
            die("kill")
    return MeshRecord(
        input=task.input,
        output=task.output,
        status="written",
        vertices=len(data),
        input_sha256=sha256,
        output_sha256=hashlib.sha256(output).hexdigest(),
    )


def children_of(pid):
    """The living processes that a process has started."""
    return [child for child, parent, _ in living_processes() if parent == pid]
