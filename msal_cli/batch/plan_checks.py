"""Every reason to refuse the outputs of a run before it touches anything."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path

from msal_cli.batch.inputs import resolve
from msal_cli.batch.temporary_files import is_own
from msal_cli.errors import UsageError
from msal_cli.job.settings import Task
from msal_cli.storage import urls
from msal_cli.storage.urls import is_url


def check_outputs(tasks: Sequence[Task]) -> None:
    """Refuse outputs that collide with one another, with inputs, with folders or with our files.

    Raises UsageError for the first that does.
    """
    _refuse_collisions(tasks)
    # An input that was named itself may be called like the manifest, the lock or a temporary file.
    for task in tasks:
        if is_own(urls.name(task.output) if is_url(task.output) else Path(task.output).name):
            raise UsageError(
                f"the output {task.output!r} would have the name of a file of msal's own",
                hint="rename the input, or name another output",
                path=task.input,
            )
    new = [task for task in tasks if not task.in_place]
    _refuse_inputs_as_outputs(new)
    _refuse_folders_as_outputs(task for task in new if not is_url(task.output))


def distinct_tasks(tasks: Sequence[Task]) -> list[int]:
    """The indices of one task for each file, which two inputs or a link may name twice.

    Hard links are as many files in place: each is replaced by a file of its own.
    """
    kept: dict[tuple[object, ...], int] = {}
    for index, task in enumerate(tasks):
        target = fold_case(str(resolve(Path(task.input)))) if task.in_place else task.output
        kept.setdefault((identify_file(task.input) or task.input, target), index)
    return list(kept.values())


def refuse_escapes(tasks: Sequence[Task], output: str) -> None:
    """Refuse outputs that a link within the output folder would carry out of it; UsageError."""
    home = resolve(Path(output))
    first: dict[Path, Task] = {}
    for task in tasks:
        first.setdefault(Path(task.output).parent, task)
    for parent, task in first.items():
        real = resolve(parent)
        if not real.is_relative_to(home):
            raise UsageError(
                f"the output {task.output!r} would leave the output folder: {str(parent)!r} "
                f"leads to {str(real)!r}",
                hint="remove the link, or make that folder the output",
                path=task.input,
            )


def identify_file(name: str) -> tuple[int, int] | str | None:
    """What distinguishes files, links of both kinds followed; None where there is no file."""
    if is_url(name):
        return urls.identity(name)
    path = Path(name)
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return (status.st_dev, status.st_ino) if status.st_ino else str(resolve(path))


def _refuse_collisions(tasks: Sequence[Task]) -> None:
    seen: dict[str, Task] = {}
    folded: dict[str, Task] = {}
    twins: list[tuple[Task, Task]] = []
    folders: dict[Path, Task] = {}
    for task in tasks:
        other = seen.setdefault(task.output, task)
        if other is not task:
            raise _collision(other, task, f"would both be written to {task.output!r}")
        if is_url(task.output):
            # A store has no folders, and every letter of a name counts.
            continue
        twin = folded.setdefault(fold_case(task.output), task)
        if twin is not task:
            twins.append((twin, task))
        for parent in Path(task.output).parents:
            if parent in folders:
                break
            folders[parent] = task
    for task in tasks:
        other = folders.get(Path(task.output), task)
        if other is not task:
            what = f"cannot both be written: {task.output!r} is to be file and folder"
            raise _collision(task, other, what)
    for first, second in twins:
        if ignores_case(next(filter(os.path.isdir, Path(first.output).parents), Path())):
            what = f"would both be written to {second.output!r}: case does not count"
            raise _collision(first, second, what)


def _collision(first: Task, second: Task, what: str) -> UsageError:
    return UsageError(
        f"the inputs {first.input!r} and {second.input!r} {what}",
        hint="rename one, leave one out with --exclude, or run them into two output folders",
        path=second.input,
    )


def fold_case(path: str) -> str:
    """Equal for paths that a file system without case and with one form of accents takes as one."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", path).casefold())


def ignores_case(folder: Path) -> bool:
    """Whether the file system of ``folder`` takes a name in capitals for the same name."""
    import tempfile

    try:
        # The one sure way is to look for a file under its other name.
        with tempfile.NamedTemporaryFile(prefix=".msal-case-", suffix=".tmp", dir=folder) as probe:
            path = Path(probe.name)
            return path.with_name(path.name.upper()).exists()
    except OSError:
        # Where nothing can be created, nothing will be written either: that error comes later.
        return False


def _refuse_inputs_as_outputs(tasks: Sequence[Task]) -> None:
    def key(path: str) -> tuple[int, int] | str:
        return identify_file(path) or str(resolve(Path(path)))

    inputs = {key(task.input): task.input for task in tasks}
    for task in tasks:
        victim = inputs.get(key(task.output))
        if victim is None:
            continue
        if victim == task.input:
            what = f"the input {task.input!r} would be overwritten by its own output"
        else:
            what = f"the output of {task.input!r} would overwrite the input {victim!r}"
        if Path(task.output) != Path(victim):
            what += f" (as {task.output!r})"
        hint = "choose another output; only msal denoise --in-place replaces inputs"
        raise UsageError(what, hint=hint, path=task.input)


def _refuse_folders_as_outputs(tasks: Iterable[Task]) -> None:
    checked: set[Path] = set()
    for task in tasks:
        output = Path(task.output)
        if os.path.isdir(output) and not os.path.islink(output):
            raise UsageError(
                f"the output of {task.input!r} is the folder {task.output!r}",
                hint="choose another output folder",
                path=task.input,
            )
        for parent in output.parents:
            if parent in checked:
                break
            checked.add(parent)
            if os.path.lexists(parent) and not os.path.isdir(parent):
                raise UsageError(
                    f"the output {task.output!r} needs a folder where {str(parent)!r} is a file",
                    path=task.input,
                )
