"""Plans for files that arrive one after another: a file that cannot be planned stops no other."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence

from msal_cli.batch.inputs import DiscoveredInput
from msal_cli.batch.plan import Plan
from msal_cli.errors import UsageError
from msal_cli.job.records import Failure, MeshRecord

BuildPlan = Callable[[Sequence[DiscoveredInput]], Plan]
"""What makes a plan of files; it raises UsageError if it refuses one of them."""


class ArrivalPlanner:
    """Plans batches of files, and knows which input each output came from."""

    def __init__(self, build: BuildPlan) -> None:
        self._build = build
        self._sources: dict[str, str] = {}

    def plan(
        self, files: Sequence[DiscoveredInput]
    ) -> tuple[list[Plan], list[tuple[DiscoveredInput, MeshRecord]]]:
        """Plans of all files that can be done, mostly one; and failed records of the others."""
        plans: list[Plan] = []
        refused: list[tuple[DiscoveredInput, MeshRecord]] = []
        for part, result in self._build_parts(files):
            if isinstance(result, UsageError):
                refused.append((part[0], _refuse(part[0], result)))
                continue
            conflicts = {
                task.input: other
                for task in result.tasks
                if (other := self._rival(task.input, task.output))
            }
            refused += [
                (one, _refuse(one, _collision(one, conflicts[one.path])))
                for one in part
                if one.path in conflicts
            ]
            if conflicts:
                kept = [one for one in part if one.path not in conflicts]
                if not kept:
                    continue
                result = self._build(kept)
            self._sources |= {os.path.normcase(task.output): task.input for task in result.tasks}
            plans.append(result)
        return plans, refused

    def _build_parts(
        self, files: Sequence[DiscoveredInput]
    ) -> Iterator[tuple[Sequence[DiscoveredInput], Plan | UsageError]]:
        """All files in one plan, or the halves that can be planned; single files are refused."""
        try:
            result: Plan | UsageError = self._build(files)
        except UsageError as error:
            if len(files) > 1:
                middle = len(files) // 2
                yield from self._build_parts(files[:middle])
                yield from self._build_parts(files[middle:])
                return
            result = error
        yield files, result

    def _rival(self, path: str, output: str) -> str:
        """Another input, still there, that the output was made of before; "" if there is none."""
        source = self._sources.get(os.path.normcase(output), path)
        return source if source != path and os.path.lexists(source) else ""


def _collision(file: DiscoveredInput, other: str) -> UsageError:
    return UsageError(
        f"its output would replace that of {other!r}",
        hint="rename one of the two, or remove the earlier one",
        path=file.path,
    )


def _refuse(file: DiscoveredInput, error: UsageError) -> MeshRecord:
    failure = Failure(error.code, error.message, error.hint or "")
    return MeshRecord(input=file.path, status="failed", error=failure)
