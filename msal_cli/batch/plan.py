"""Which output each input gets."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from msal_cli.batch.inputs import DiscoveredInput, resolve
from msal_cli.batch.manifest_dirs import list_objects, written_names
from msal_cli.batch.plan_checks import (
    check_outputs,
    distinct_tasks,
    fold_case,
    ignores_case,
    refuse_escapes,
)
from msal_cli.batch.shard import Shard
from msal_cli.errors import UsageError
from msal_cli.job.records import ObjectMark
from msal_cli.job.settings import (
    DEFAULT_BACKUP,
    Task,
    is_mesh_name,
    output_name,
    refuse_unknown_format,
)
from msal_cli.storage import urls
from msal_cli.storage.urls import is_url


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
    objects : where the outputs go to a store, size and tag of those that are there, by URL.
    is_set : the files are denoised as one mesh: all of them, or none.
    """

    tasks: tuple[Task, ...]
    homes: tuple[str | None, ...]
    fresh: bool = False
    retry_failed: bool = False
    shard: Shard | None = None
    whole: Plan | None = None
    objects: Mapping[str, ObjectMark] = field(default_factory=dict)
    is_set: bool = False

    def folders(self) -> list[str]:
        """All homes, each once; of a part those of the whole, for it works under their locks."""
        homes = self.homes if self.whole is None else self.whole.homes
        return sorted({home for home in homes if home is not None})

    @property
    def is_in_process(self) -> bool:
        """Whether no other process could do the work: the objects live in this one."""
        objects = [
            path for task in self.tasks for path in (task.input, task.output) if is_url(path)
        ]
        if not objects:
            return False
        from msal_cli.storage import objects as remote

        return any(map(remote.is_in_process, objects))

    def manifest_key(self, index: int) -> str:
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
    """The plan that writes every file of ``found`` to its place; nothing is touched.

    A single file that was named itself goes to ``output`` as a file if that is a file, or is
    nothing yet and has a mesh suffix.  Otherwise ``output`` is a folder and each input goes to its
    relative path below it, with the suffix of ``to`` where given.  A new folder that is called like
    a file is refused, unless a slash at the end of ``output`` says that it is one.

    With ``in_place`` every input is its own output (a link's target, where it is a link), and
    ``backup`` is the suffix of the copy that keeps the original; None keeps none.

    ``force`` allows files in the output folder to be replaced that no earlier run put there;
    ``fresh`` does every file again, ``retry_failed`` those that failed before.  With ``is_set`` the
    files are those of a tile set.

    Raises
    ------
    UsageError : ``output`` is called like a file of no known format, or like one file for several
        inputs; two inputs have one output; an output is an input, a folder, lies outside the
        output folder or would replace a file that is not ours; options contradict each other.
    """
    output = None if output is None else urls.normalize_url(output)
    homes: Sequence[str | None]
    if in_place:
        _check_in_place(found, output, to, backup)
        tasks = [_in_place_task(one, backup) for one in found]
        # Also a single file has a manifest: without it a second run would denoise it twice.
        homes = [
            str(Path(one.root) if one.root else Path(task.input).parent)
            for one, task in zip(found, tasks, strict=True)
        ]
    elif output is None:
        raise UsageError("there is no output", hint="name one with -o, or give --in-place")
    elif _is_file_output(found, output):
        _check_file_output(output, to)
        tasks = [Task(found[0].path, output, found[0].relative, input_mark=found[0].mark)]
        homes = [None]
    else:
        _check_folder_output(found, output)
        tasks = [_mirror(one, output, to) for one in found]
        homes = [output] * len(tasks)
    plan = Plan(tuple(tasks), tuple(homes), fresh, retry_failed, is_set=is_set)
    plan = _subset(plan, distinct_tasks(plan.tasks))
    check_outputs(plan.tasks)
    if output is not None and homes[:1] != [None]:
        if is_url(output):
            plan = replace(plan, objects=list_objects(output, plan.tasks))
        else:
            refuse_escapes(plan.tasks, output)
        if not force:
            _refuse_foreign_files(plan, output)
    return plan


def select_shard(plan: Plan, shard: Shard) -> Plan:
    """The part of a checked plan that ``shard`` is to do; it may be empty."""
    kept = (index for index, task in enumerate(plan.tasks) if shard.has(task.relative))
    return replace(_subset(plan, kept), shard=shard, whole=plan)


def _subset(plan: Plan, indices: Iterable[int]) -> Plan:
    kept = tuple(indices)
    tasks, homes = plan.tasks, plan.homes
    return replace(plan, tasks=tuple(tasks[i] for i in kept), homes=tuple(homes[i] for i in kept))


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
        if not backup or "/" in backup or os.sep in backup or "\0" in backup:
            raise UsageError(f"{backup!r} cannot be the suffix of a backup")
        if is_mesh_name("a.ply" + backup):
            raise UsageError(
                f"backups named *{backup} would be inputs of the next run",
                hint=f"take a suffix that is no mesh format, such as {DEFAULT_BACKUP}",
            )
    for one in found:
        if is_url(one.path):
            raise UsageError(
                f"--in-place is for files, and {one.path!r} is in a store",
                hint="name another place with -o: a store cannot keep the original safe",
                path=one.path,
            )


def _in_place_task(one: DiscoveredInput, backup: str | None) -> Task:
    target = Path(one.path)
    if os.path.islink(target):
        # A link stays a link: the file that it leads to is the one to replace.  It is named from
        # the folder that was searched, so that there is one manifest for all in it.
        real, real_root = resolve(target), resolve(Path(one.root))
        if one.root and not real.is_relative_to(real_root):
            raise UsageError(
                f"{one.path!r} leads out of {one.root!r} to {str(real)!r}",
                hint="leave it out with --exclude, or name it as an input itself",
                path=one.path,
            )
        target = Path(one.root) / real.relative_to(real_root) if one.root else real
    return Task(str(target), str(target), one.relative, in_place=True, backup=backup)


def _is_file_output(found: Sequence[DiscoveredInput], output: str) -> bool:
    if len(found) != 1 or found[0].root or output.endswith(("/", os.sep)):
        return False
    if is_url(output):
        return is_mesh_name(urls.name(output))
    if os.path.isdir(output):
        return False
    return os.path.lexists(output) or is_mesh_name(Path(output).name)


def _check_file_output(output: str, to: str | None) -> None:
    if not is_mesh_name(output):
        refuse_unknown_format(output)
    name = Path(output).name
    if to is None or not is_mesh_name(name):
        return
    if output_name(name, to).casefold() != name.casefold():
        raise UsageError(
            f"--to {to} contradicts the suffix of the output {output!r}",
            hint="leave --to out: the suffix of the output decides",
        )


def _check_folder_output(found: Sequence[DiscoveredInput], output: str) -> None:
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


def _mirror(one: DiscoveredInput, output: str, to: str | None) -> Task:
    if is_url(one.path) or is_url(output):
        name = urls.harmless(one.relative, is_local=not is_url(output))
        folder, slash, last = name.rpartition("/")
        name = folder + slash + output_name(last, to)
        place = urls.join_url(output, name) if is_url(output) else str(Path(output) / name)
        return Task(one.path, place, one.relative, input_mark=one.mark)
    relative = PurePosixPath(one.relative)
    if relative.is_absolute() or ".." in relative.parts or Path(one.relative).drive:
        raise UsageError(f"{one.relative!r} is no path below the output folder", path=one.path)
    relative = relative.with_name(output_name(relative.name, to))
    return Task(one.path, str(Path(output) / relative), one.relative)


def _refuse_foreign_files(plan: Plan, output: str) -> None:
    existing = [
        index
        for index, task in enumerate(plan.tasks)
        if task.output in plan.objects or (not is_url(output) and os.path.lexists(task.output))
    ]
    own = written_names(output) if existing else frozenset()
    foreign = [plan.tasks[index] for index in existing if plan.manifest_key(index) not in own]
    if foreign and not is_url(output) and ignores_case(Path(output)):
        # An input that was renamed from A.ply to a.ply keeps its output.
        folded = set(map(fold_case, own))
        foreign = [
            plan.tasks[index]
            for index in existing
            if fold_case(plan.manifest_key(index)) not in folded
        ]
    if foreign:
        names = ", ".join(repr(task.output) for task in foreign[:3])
        more = f" and {len(foreign) - 3} more" if len(foreign) > 3 else ""
        raise UsageError(
            f"{names}{more} in the output folder "
            "would be overwritten, and no run of msal denoise put it there",
            hint="choose another output folder, or give --force to overwrite",
            path=foreign[0].input,
        )
