"""Assign an output to each input, and refuse a harmful plan before anything is touched."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from msal_cli.batch.inputs import DiscoveredInput, resolve
from msal_cli.batch.lock import Shard
from msal_cli.codecs.detection import format_of_name, output_name, refuse_unknown_format
from msal_cli.errors import InputError, OutputError, UsageError
from msal_cli.job.settings import DEFAULT_BACKUP, Task
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage import urls
from msal_cli.storage.atomic import is_own
from msal_cli.storage.urls import ObjectMark, is_url


@dataclass(frozen=True)
class Plan:
    """What a run is to do.

    ``fresh`` does every file again, even where its output is current, and ``retry_failed`` those
    that failed before.  A part of a plan has its ``shard``, and the ``whole`` plan (see
    ``select_shard``).  ``objects`` are size and tag of the outputs that are in a store already, by
    URL.  With ``is_set`` the files are denoised as one mesh: all of them, or none.
    """

    tasks: tuple[Task, ...]
    fresh: bool = False
    retry_failed: bool = False
    shard: Shard | None = None
    whole: Plan | None = None
    objects: Mapping[str, ObjectMark] = field(default_factory=dict)
    is_set: bool = False

    def folders(self) -> list[str]:
        """All places with a manifest; for a shard those of the whole plan: it locks them all."""
        plan = self.whole or self
        return sorted({task.manifest_dir for task in plan.tasks if task.manifest_dir is not None})

    @property
    def is_in_process(self) -> bool:
        """Whether only this process can do the work: ``memory://`` objects exist only in it."""
        paths = (path for task in self.tasks for path in (task.input, task.output))
        return any(path.startswith("memory://") for path in paths)

    def select_shard(self, shard: Shard) -> Plan:
        """The part of a checked plan that ``shard`` is to do; it may be empty."""
        tasks = tuple(task for task in self.tasks if shard.has(task.relative))
        return replace(self, tasks=tasks, shard=shard, whole=self)


def manifest_key(task: Task) -> str:
    """The name of a task in its manifest: the path of the output below the folder, with ``/``."""
    place, output = task.manifest_dir, task.output
    assert place is not None
    if is_url(place):
        return output.removeprefix(urls.folder(place))
    start = place + os.sep
    if os.sep == "/" and output.startswith(start) and not place.endswith("/"):
        return output[len(start) :]
    return Path(output).relative_to(place).as_posix()


def output_folders(tasks: Iterable[Task]) -> set[Path]:
    """The local folders that tasks write to; ``-`` is standard output."""
    files = (task.output for task in tasks if not is_url(task.output) and task.output != "-")
    return {Path(file).parent for file in files}


def build_plan(
    found: Sequence[DiscoveredInput],
    output: str | None,
    *,
    to: str | None = None,
    in_place: bool = False,
    backup: str | None = DEFAULT_BACKUP,
    force: bool = False,
    fresh: bool = False,
    retry_failed: bool = False,
    is_set: bool = False,
) -> Plan:
    """Plan an output for every file of ``found``; nothing is touched.

    A single input file goes to ``output`` as a file if that is a file, or does not exist and has a
    mesh suffix.  Otherwise ``output`` is a folder and each input goes to its relative path below
    it, with the suffix ``to`` if given.  A new folder with a mesh suffix is refused, unless
    ``output`` ends with a slash.

    With ``in_place`` every input is its own output (for a link, its target), and ``backup`` is the
    suffix of the copy that keeps the original; None keeps none.

    ``force`` allows files in the output folder to be replaced that no earlier run wrote, and
    materials beside earlier outputs; ``fresh`` does every file again, ``retry_failed`` those that
    failed before.  With ``is_set`` the files are those of a tile set.

    Raises UsageError if ``output`` has an unknown format, or names one file for several inputs; if
    two inputs have the same output; if an output is an input or a folder, lies outside the output
    folder, or would replace a file that is not msal's; if options contradict each other.
    """
    output = None if output is None else urls.normalize_url(output)
    if in_place:
        _check_in_place(found, output, to, backup)
        tasks = [_in_place_task(file, backup) for file in found]
    elif not output:
        raise UsageError("there is no output", hint="name one with -o, or give --in-place")
    elif _is_file_output(found, output):
        if to is not None and output_name(output, to).casefold() != output.casefold():
            raise UsageError(
                f"--to {to} contradicts the suffix of the output {output!r}",
                hint="leave --to out: the suffix of the output decides",
            )
        tasks = [Task(found[0].path, output, found[0].relative, input_mark=found[0].mark)]
    else:
        tasks = [_mirror(file, output, to) for file in found]
    if len(tasks) > 1:
        tasks = _distinct_tasks(tasks)
        _refuse_collisions(tasks)
    _check_outputs(tasks)
    tasks = [replace(task, force=True) for task in tasks] if force else tasks
    plan = Plan(tuple(tasks), fresh, retry_failed, is_set=is_set)
    if output is not None and plan.folders():
        if is_url(output):
            plan = replace(plan, objects=_list_outputs(output, plan.tasks))
        else:
            _refuse_escapes(plan.tasks, output)
        if not force:
            _refuse_foreign_files(plan, output)
    return plan


def _check_in_place(
    found: Sequence[DiscoveredInput], output: str | None, to: str | None, backup: str | None
) -> None:
    if output is not None:
        raise UsageError("--in-place and an output were both given", hint="give one of them")
    if to is not None:
        raise UsageError(
            "--in-place cannot change the format", hint="name an output with -o to use --to"
        )
    if backup is not None:
        if not isinstance(backup, str) or not backup or {"/", os.sep, "\0"} & {*backup}:
            raise UsageError(f"{backup!r} cannot be the suffix of a backup")
        if format_of_name("a.ply" + backup):
            raise UsageError(
                f"backups named *{backup} would be inputs of the next run",
                hint=f"take a suffix that is no mesh format, such as {DEFAULT_BACKUP}",
            )
    for file in found:
        if is_url(file.path):
            raise UsageError(
                f"--in-place is for files, and {file.path!r} is in a store",
                hint="name another place with -o: a store cannot keep the original safe",
                path=file.path,
            )


def _in_place_task(file: DiscoveredInput, backup: str | None) -> Task:
    target = Path(file.path)
    if os.path.islink(target):
        # A link stays a link: its target is replaced.  The target gets a path below the searched
        # folder, so that one manifest covers all files in that folder.
        real, real_root = resolve(target), resolve(Path(file.root))
        if file.root and not real.is_relative_to(real_root):
            raise UsageError(
                f"{file.path!r} leads out of {file.root!r} to {str(real)!r}",
                hint="leave it out with --exclude, or name it as an input itself",
                path=file.path,
            )
        target = Path(file.root) / real.relative_to(real_root) if file.root else real
    path = str(target)
    # A single file has a manifest, too: without it a second run would denoise it again.
    place = str(Path(file.root) if file.root else target.parent)
    return Task(path, path, file.relative, in_place=True, backup=backup, manifest_dir=place)


def _is_file_output(found: Sequence[DiscoveredInput], output: str) -> bool:
    """Whether the output is a file; UsageError for a new folder with a mesh suffix."""
    if output.endswith(("/", os.sep)) or (not is_url(output) and os.path.isdir(output)):
        return False
    if len(found) == 1 and not found[0].root:
        refuse_unknown_format(output)
        return format_of_name(output) != "" or (not is_url(output) and os.path.lexists(output))
    if format_of_name(output):
        raise UsageError(
            f"the output {output!r} is called like one mesh file, and a folder or several files "
            "are the input",
            hint=f"write {output + '/'!r} if that is to be a folder, or name one input file",
        )
    return False


def _mirror(file: DiscoveredInput, output: str, to: str | None) -> Task:
    if is_url(file.path) or is_url(output):
        name = urls.escape_name(file.relative, is_local=not is_url(output))
        folder, slash, last = name.rpartition("/")
        name = folder + slash + output_name(last, to)
        place = urls.folder(output) + name if is_url(output) else str(Path(output) / name)
        return Task(file.path, place, file.relative, input_mark=file.mark, manifest_dir=output)
    relative = PurePosixPath(file.relative)
    if relative.is_absolute() or ".." in relative.parts or Path(file.relative).drive:
        raise UsageError(f"{file.relative!r} is no path below the output folder", path=file.path)
    relative = relative.with_name(output_name(relative.name, to))
    place = str(Path(output) / relative)
    depth = len(Path(file.path).relative_to(file.root).parts) - 1 if file.root else 0
    return Task(file.path, place, file.relative, manifest_dir=output, depth=depth)


def _refuse_foreign_files(plan: Plan, output: str) -> None:
    existing = [
        task
        for task in plan.tasks
        if task.output in plan.objects or (not is_url(output) and os.path.lexists(task.output))
    ]
    if not existing:
        return
    from msal_cli.batch.manifest import merge_entries, read_views

    own = merge_entries(read_views(output))
    foreign = [task for task in existing if manifest_key(task) not in own]
    if foreign:
        names = ", ".join(repr(task.output) for task in foreign[:3])
        more = f" and {len(foreign) - 3:,} more" if len(foreign) > 3 else ""
        raise UsageError(
            f"{names}{more} in the output folder "
            "would be overwritten, and no run of msal denoise put it there",
            hint="choose another output folder, or give --force to overwrite",
            path=foreign[0].input,
        )


def _list_outputs(url: str, tasks: Iterable[Task]) -> dict[str, ObjectMark]:
    """Size and tag of the outputs that are in a store already, by URL, from one listing."""
    from msal_cli.storage import objects

    try:
        marks = objects.list_objects(url)
    except InputError as error:
        raise OutputError(error.message, hint=error.hint, path=url) from None
    start = urls.folder(url)
    found = ((task.output, marks.get(task.output.removeprefix(start))) for task in tasks)
    return {url: mark for url, mark in found if mark is not None}


# Refusals before anything is touched


def _check_outputs(tasks: Sequence[Task]) -> None:
    """Refuse an output that is an input or a folder, lies below a file, or has a reserved name."""
    # An input that was given by name may be called like the manifest, the lock or a temporary file.
    for task in tasks:
        if is_own(urls.name(task.output) if is_url(task.output) else Path(task.output).name):
            raise UsageError(
                f"the output {task.output!r} would have the name of a file of msal's own",
                hint="rename the input, or name another output",
                path=task.input,
            )
    inputs = {identify(task.input): task.input for task in tasks}
    checked: set[Path] = set()
    for task in tasks:
        if task.in_place:
            continue
        if victim := inputs.get(identify(task.output)):
            what = f"the output of {task.input!r} would overwrite the input {victim!r}"
            if victim == task.input:
                what = f"the input {victim!r} would be overwritten by its own output"
            if Path(task.output) != Path(victim):
                what += f" (as {task.output!r})"
            hint = "choose another output; only --in-place replaces inputs"
            raise UsageError(what, hint=hint, path=task.input)
        if is_url(task.output):
            continue
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


def _distinct_tasks(tasks: Sequence[Task]) -> list[Task]:
    """One task per file, even where two inputs or a link name it twice.

    In place, hard links are separate files: each is replaced by a file of its own.
    """
    kept: dict[tuple[object, ...], Task] = {}
    for task in tasks:
        target = fold_case(str(resolve(Path(task.input)))) if task.in_place else task.output
        kept.setdefault((identify_file(task.input) or task.input, target), task)
    return list(kept.values())


def _refuse_escapes(tasks: Sequence[Task], output: str) -> None:
    """Refuse outputs that a link within the output folder would redirect outside of it."""
    folder = resolve(Path(output))
    first: dict[Path, Task] = {}
    for task in tasks:
        first.setdefault(Path(task.output).parent, task)
    for parent, task in first.items():
        real = resolve(parent)
        if not real.is_relative_to(folder):
            raise UsageError(
                f"the output {task.output!r} would leave the output folder: {str(parent)!r} "
                f"leads to {str(real)!r}",
                hint="remove the link, or make that folder the output",
                path=task.input,
            )


def identify_file(name: str) -> tuple[int, int] | str | None:
    """A value that is equal for all paths and links of one file; None if there is no file."""
    if is_url(name):
        return urls.identity(name)
    path = Path(name)
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return (status.st_dev, status.st_ino) if status.st_ino else str(resolve(path))


def identify(name: str) -> tuple[int, int] | str:
    """As ``identify_file``; for a missing file its resolved path."""
    return identify_file(name) or str(resolve(Path(name)))


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
            # A store has no folders, and case matters in its names.
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
    """A key that is equal for paths that differ only in case or in Unicode normalization."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", path).casefold())


def ignores_case(folder: Path) -> bool:
    import tempfile

    try:
        # The only sure test is to look for a file by its name in upper case.
        with tempfile.NamedTemporaryFile(prefix=".msal-case-", suffix=".tmp", dir=folder) as probe:
            path = Path(probe.name)
            return path.with_name(path.name.upper()).exists()
    except OSError:
        # Where nothing can be created, nothing will be written either: that error comes later.
        return False
