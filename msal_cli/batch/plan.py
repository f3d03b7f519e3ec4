"""Which output each input gets, and every reason to refuse a run before it touches anything."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from msal_cli.batch.inputs import Found, resolve
from msal_cli.batch.manifest import names_in
from msal_cli.batch.manifest_dirs import manifest_of, objects_at
from msal_cli.batch.shard import Shard
from msal_cli.batch.temporary_files import is_own
from msal_cli.errors import UsageError
from msal_cli.job.records import ObjectMark
from msal_cli.job.settings import DEFAULT_BACKUP, Task, refuse_unknown_format
from msal_cli.job.settings import is_mesh_name as known_suffix
from msal_cli.job.settings import output_name as with_suffix_of
from msal_cli.storage import urls
from msal_cli.storage.urls import is_url

_OTHER_OUTPUT = "choose another output; only msal denoise --in-place replaces inputs"


@dataclass(frozen=True)
class Plan:
    """What a run is to do.

    Attributes
    ----------
    tasks : one per input file, in the order of the inputs.
    homes : for each task the folder whose manifest notes it, or None where there is none (one
        file into one file).  It is the output folder or, in place, the folder that was searched
        or holds the file.
    fresh : do every file again, even where its output is current.
    retry_failed : do files again that failed before, even where they would fail again.
    shard, whole : which part this is, and of what, where it is a part (see ``select_shard``).
    objects : where the outputs go to a store, the marks of those that are there, by URL.
    """

    tasks: tuple[Task, ...]
    homes: tuple[str | None, ...]
    fresh: bool = False
    retry_failed: bool = False
    shard: Shard | None = None
    whole: Plan | None = None
    objects: Mapping[str, ObjectMark] = field(default_factory=dict)

    def folders(self) -> list[str]:
        """All homes, each once; of a part those of the whole, for it works under their locks."""
        homes = self.homes if self.whole is None else self.whole.homes
        return sorted({home for home in homes if home is not None})

    @property
    def stays_here(self) -> bool:
        """Whether no other process could do the work: the objects live in this one."""
        objects = [
            path for task in self.tasks for path in (task.input, task.output) if is_url(path)
        ]
        if not objects:
            return False
        from msal_cli.storage import objects as remote

        return any(map(remote.is_in_process, objects))

    def key(self, index: int) -> str:
        """The name by which the manifest knows a task: its output below its home, with ``/``."""
        home = self.homes[index]
        if home is None:
            raise ValueError(f"task {index} has no manifest")
        if is_url(home):
            return self.tasks[index].output.removeprefix(urls.folder(home))
        output, start = self.tasks[index].output, home + os.sep
        if os.sep == "/" and output.startswith(start) and not home.endswith("/"):
            return output[len(start) :]
        return Path(self.tasks[index].output).relative_to(home).as_posix()


def built(
    found: Sequence[Found],
    output: str | None,
    *,
    to: str | None = None,
    in_place: bool = False,
    backup: str | None = DEFAULT_BACKUP,
    force: bool = False,
    fresh: bool = False,
    retry_failed: bool = False,
    is_mesh_name: Callable[[str], bool] = known_suffix,
    output_name: Callable[[str, str | None], str] = with_suffix_of,
) -> Plan:
    """The plan that writes every file of ``found`` to its place; nothing is touched.

    A single file that was named itself goes to ``output`` as a file if that is a file, or is
    nothing yet and has a mesh suffix.  Otherwise ``output`` is a folder and each input goes to its
    relative path below it, with the suffix of ``to`` where given.  A new folder that is called like
    a file is refused, unless a slash at the end of ``output`` says that it is one.

    With ``in_place`` every input is its own output (a link's target, where it is a link), and
    ``backup`` is the suffix of the copy that keeps the original; None keeps none.

    ``force`` allows files in the output folder to be replaced that no earlier run put there;
    ``fresh`` does every file again, ``retry_failed`` those that failed before.

    Raises
    ------
    UsageError : ``output`` is called like a file of no known format, or like one file for several
        inputs; two inputs have one output; an output is an input, a folder, lies outside the
        output folder or would replace a file that is not ours; options contradict each other.
    """
    output = None if output is None else urls.settled(output)
    if in_place:
        plan = _in_place(found, output, to, backup, fresh, is_mesh_name)
    elif output is None:
        raise UsageError("there is no output", hint="name one with -o, or give --in-place")
    elif _is_file_output(found, output, is_mesh_name):
        if not is_mesh_name(output):
            refuse_unknown_format(output)
        _refuse_contradiction(output, to, is_mesh_name, output_name)
        task = Task(found[0].path, output, found[0].relative, input_mark=found[0].mark)
        plan = Plan((task,), (None,), fresh)
    else:
        _refuse_file_names(found, output, is_mesh_name)
        tasks = tuple(_mirrored(one, output, to, output_name) for one in found)
        plan = Plan(tasks, (output,) * len(tasks), fresh)
    plan = replace(_without_repeats(plan), retry_failed=retry_failed)
    _refuse_collisions(plan)
    _refuse_own_names(plan)
    if not in_place:
        _refuse_inputs_as_outputs(plan)
        if output is None or not is_url(output):
            _refuse_folders_as_outputs(plan)
    if plan.homes[:1] != (None,) and not in_place and output is not None:
        if is_url(output):
            plan = replace(plan, objects=objects_at(output, plan.tasks))
        else:
            _refuse_escapes(plan, output)
        if not force:
            _refuse_foreign_files(plan, output)
    return plan


def select_shard(plan: Plan, shard: Shard) -> Plan:
    """The part of a checked plan that ``shard`` is to do; it may be empty."""
    kept = (index for index, task in enumerate(plan.tasks) if shard.has(task.relative))
    return replace(_subset(plan, kept), shard=shard, whole=plan)


def _in_place(
    found: Sequence[Found],
    output: str | None,
    to: str | None,
    backup: str | None,
    fresh: bool,
    is_mesh_name: Callable[[str], bool],
) -> Plan:
    if output is not None:
        raise UsageError("--in-place and an output were both given", hint="give one of them")
    if to is not None:
        raise UsageError(
            "--in-place cannot change the format", hint="name an output with -o to use --to"
        )
    if backup is not None:
        if not backup or "/" in backup or os.sep in backup or "\0" in backup:
            raise UsageError(f"{backup!r} cannot be the suffix of a backup")
        if is_mesh_name("a.ply" + backup):
            raise UsageError(
                f"backups named *{backup} would be inputs of the next run",
                hint=f"take a suffix that is no mesh format, such as {DEFAULT_BACKUP}",
            )
    tasks, homes = [], []
    for one in found:
        if is_url(one.path):
            raise UsageError(
                f"--in-place is for files, and {one.path!r} is in a store",
                hint="name another place with -o: a store cannot keep the original safe",
                path=one.path,
            )
        path = Path(one.path)
        real = resolve(path)
        root = Path(one.root) if one.root else None
        if root is not None and os.path.islink(path) and not real.is_relative_to(resolve(root)):
            raise UsageError(
                f"{one.path!r} leads out of {one.root!r} to {str(real)!r}",
                hint="leave it out with --exclude, or name it as an input itself",
                path=one.path,
            )
        # A link stays a link: the file that it leads to is the one to replace.  It is named from
        # the folder that was searched, so that there is one manifest for all in it.
        target = path
        if os.path.islink(path):
            target = real if root is None else root / real.relative_to(resolve(root))
        tasks.append(Task(str(target), str(target), one.relative, in_place=True, backup=backup))
        # Also a single file has a manifest: without it a second run would denoise it twice.
        homes.append(str(target.parent if root is None else root))
    return Plan(tuple(tasks), tuple(homes), fresh)


def _is_file_output(
    found: Sequence[Found], output: str, is_mesh_name: Callable[[str], bool]
) -> bool:
    if len(found) != 1 or found[0].root or output.endswith(("/", os.sep)):
        return False
    if is_url(output):
        return is_mesh_name(urls.name(output))
    path = Path(output)
    if os.path.isdir(path):
        return False
    return os.path.lexists(path) or is_mesh_name(path.name)


def _refuse_file_names(
    found: Sequence[Found], output: str, is_mesh_name: Callable[[str], bool]
) -> None:
    """Refuse a folder that is to be made and is called like a file."""
    if output.endswith(("/", os.sep)) or (not is_url(output) and os.path.isdir(output)):
        return
    if len(found) == 1 and not found[0].root:
        refuse_unknown_format(output)
    elif is_mesh_name(output):
        raise UsageError(
            f"the output {output!r} is called like one mesh file, and a folder or several files "
            "are the input",
            hint=f"write {output + '/'!r} if that is to be a folder, or name one input file",
        )


def _refuse_contradiction(
    output: str,
    to: str | None,
    is_mesh_name: Callable[[str], bool],
    output_name: Callable[[str, str | None], str],
) -> None:
    name = Path(output).name
    if to is None or not is_mesh_name(name):
        return
    if output_name(name, to).casefold() != name.casefold():
        raise UsageError(
            f"--to {to} contradicts the suffix of the output {output!r}",
            hint="leave --to out: the suffix of the output decides",
        )


def _mirrored(
    one: Found, output: str, to: str | None, output_name: Callable[[str, str | None], str]
) -> Task:
    if is_url(one.path) or is_url(output):
        name = urls.harmless(one.relative, is_local=not is_url(output))
        folder, slash, last = name.rpartition("/")
        name = folder + slash + output_name(last, to)
        place = urls.joined(output, name) if is_url(output) else str(Path(output) / name)
        return Task(one.path, place, one.relative, input_mark=one.mark)
    relative = PurePosixPath(one.relative)
    if relative.is_absolute() or ".." in relative.parts or Path(one.relative).drive:
        raise UsageError(f"{one.relative!r} is no path below the output folder", path=one.path)
    relative = relative.with_name(output_name(relative.name, to))
    return Task(one.path, str(Path(output) / relative), one.relative)


def _identity(name: str) -> tuple[int, int] | str | None:
    """What tells files apart, links of both kinds followed; None where there is no file."""
    if is_url(name):
        return urls.identity(name)
    path = Path(name)
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return (status.st_dev, status.st_ino) if status.st_ino else str(resolve(path))


def _without_repeats(plan: Plan) -> Plan:
    """One task for a file that was found twice (by two inputs, or in place by a link).

    Hard links are as many files in place: each is replaced by a file of its own.
    """
    kept: dict[tuple[object, ...], int] = {}
    for index, task in enumerate(plan.tasks):
        source = _identity(task.input) or task.input
        target = _folded(str(resolve(Path(task.input)))) if task.in_place else task.output
        kept.setdefault((source, target), index)
    return _subset(plan, kept.values())


def _subset(plan: Plan, indices: Iterable[int]) -> Plan:
    kept = tuple(indices)
    tasks, homes = plan.tasks, plan.homes
    return replace(plan, tasks=tuple(tasks[i] for i in kept), homes=tuple(homes[i] for i in kept))


def _refuse_collisions(plan: Plan) -> None:
    seen: dict[str, Task] = {}
    folded: dict[str, Task] = {}
    twins: list[tuple[Task, Task]] = []
    holders: dict[Path, Task] = {}
    for task in plan.tasks:
        other = seen.setdefault(task.output, task)
        if other is not task:
            raise _collision(other, task, f"would both be written to {task.output!r}")
        if is_url(task.output):
            # A store has no folders, and every letter of a name counts.
            continue
        twin = folded.setdefault(_folded(task.output), task)
        if twin is not task:
            twins.append((twin, task))
        for parent in Path(task.output).parents:
            if parent in holders:
                break
            holders[parent] = task
    for task in plan.tasks:
        other = holders.get(Path(task.output), task)
        if other is not task:
            raise _collision(
                task, other, f"cannot both be written: {task.output!r} is to be file and folder"
            )
    for first, second in twins:
        folder = next((one for one in Path(first.output).parents if os.path.isdir(one)), Path())
        if _ignores_case(folder):
            raise _collision(
                first, second, f"would both be written to {second.output!r}: case does not count"
            )


def _refuse_own_names(plan: Plan) -> None:
    """An input that was named itself may be called like the manifest, the lock or a temporary."""
    for task in plan.tasks:
        if is_own(
            task.output.rpartition("/")[2] if is_url(task.output) else Path(task.output).name
        ):
            raise UsageError(
                f"the output {task.output!r} would have the name of a file of msal's own",
                hint="rename the input, or name another output",
                path=task.input,
            )


def _collision(first: Task, second: Task, what: str) -> UsageError:
    return UsageError(
        f"the inputs {first.input!r} and {second.input!r} {what}",
        hint="rename one, leave one out with --exclude, or run them into two output folders",
        path=second.input,
    )


def _folded(path: str) -> str:
    """Equal for paths that a file system without case and with one form of accents takes as one."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", path).casefold())


def _ignores_case(folder: Path) -> bool:
    """Whether the file system of ``folder`` takes a name in capitals for the same name."""
    import tempfile

    try:
        # The one sure way is to ask for a file under its other name.
        with tempfile.NamedTemporaryFile(prefix=".msal-case-", suffix=".tmp", dir=folder) as probe:
            path = Path(probe.name)
            return path.with_name(path.name.upper()).exists()
    except OSError:
        # Where nothing can be created, nothing will be written either: that error comes later.
        return False


def _refuse_inputs_as_outputs(plan: Plan) -> None:
    inputs = {}
    for task in plan.tasks:
        inputs[_identity(task.input) or str(resolve(Path(task.input)))] = task.input
    for task in plan.tasks:
        output = Path(task.output)
        victim = inputs.get(_identity(task.output) or str(resolve(output)))
        if victim is None:
            continue
        if victim == task.input:
            what = f"the input {task.input!r} would be overwritten by its own output"
        else:
            what = f"the output of {task.input!r} would overwrite the input {victim!r}"
        if output != Path(victim):
            what += f" (as {task.output!r})"
        raise UsageError(what, hint=_OTHER_OUTPUT, path=task.input)


def _refuse_folders_as_outputs(plan: Plan) -> None:
    checked: set[Path] = set()
    for task in plan.tasks:
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


def _refuse_escapes(plan: Plan, output: str) -> None:
    """A link within the output folder must not carry an output out of it."""
    home = resolve(Path(output))
    checked: set[Path] = set()
    for task in plan.tasks:
        parent = Path(task.output).parent
        if parent in checked:
            continue
        checked.add(parent)
        real = resolve(parent)
        if not real.is_relative_to(home):
            raise UsageError(
                f"the output {task.output!r} would leave the output folder: {str(parent)!r} "
                f"leads to {str(real)!r}",
                hint="remove the link, or make that folder the output",
                path=task.input,
            )


def _refuse_foreign_files(plan: Plan, output: str) -> None:
    existing = [
        index
        for index, task in enumerate(plan.tasks)
        if task.output in plan.objects or (not is_url(output) and os.path.lexists(task.output))
    ]
    if not existing:
        return
    explained = manifest_of(output).names() if is_url(output) else names_in(output)
    foreign = [plan.tasks[index] for index in existing if plan.key(index) not in explained]
    if foreign:
        raise UsageError(
            f"{_listed(task.output for task in foreign)} in the output folder "
            "would be overwritten, and no run of msal denoise put it there",
            hint="choose another output folder, or give --force to overwrite",
            path=foreign[0].input,
        )


def _listed(names: Iterable[str], at_most: int = 3) -> str:
    everything = list(names)
    text = ", ".join(repr(name) for name in everything[:at_most])
    more = len(everything) - at_most
    return f"{text} and {more} more" if more > 0 else text
