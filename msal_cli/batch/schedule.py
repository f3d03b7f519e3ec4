"""The order of the tasks: large ones first, and no more at once than fit into memory.

Nothing here starts or waits for anything; that is the part of ``worker_pool.WorkerPool``.
"""

from __future__ import annotations

import collections
from collections.abc import Iterable, Mapping


class TaskQueue:
    """The tasks that are yet to be handed out.

    Parameters
    ----------
    tasks : indices, in the order of the plan.
    weights : bytes of memory that the large ones among them are expected to need at their peak.
        They go first, heaviest first, so that none is left to run alone at the end.
    light_bytes : what any other is expected to need.
    budget_bytes : what all current tasks together may need; None is no bound.
    """

    def __init__(
        self,
        tasks: Iterable[int],
        *,
        weights: Mapping[int, int] | None = None,
        light_bytes: int = 0,
        budget_bytes: int | None = None,
    ) -> None:
        self._weights = dict(weights or {})
        self._light_bytes = light_bytes
        self._budget = budget_bytes
        indices = list(tasks)
        heavy = [index for index in indices if index in self._weights]
        heavy.sort(key=lambda index: -self._weights[index])
        self._exclusive = collections.deque(filter(self._fits_with_no_other, heavy))
        self._heavy = collections.deque(heavy[len(self._exclusive) :])
        self._light = collections.deque(index for index in indices if index not in self._weights)
        self._retries: collections.deque[int] = collections.deque()

    def __len__(self) -> int:
        """How many tasks wait for their first try."""
        return len(self._exclusive) + len(self._heavy) + len(self._light)

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits, second tries included."""
        return not len(self) and not self._retries

    def drop(self) -> None:
        """Give up the tasks that wait for their first try."""
        for queue in (self._exclusive, self._heavy, self._light):
            queue.clear()

    def weight(self, index: int) -> int:
        """Bytes that a task is expected to need."""
        return self._weights.get(index, self._light_bytes)

    def retry(self, index: int) -> None:
        """Add a task that was lost; it runs alone, after all others."""
        self._retries.append(index)

    def put_back(self, index: int, *, is_retry: bool = False) -> None:
        """A task that was taken did not reach its worker: it is next again."""
        if is_retry:
            self._retries.appendleft(index)
        elif index not in self._weights:
            self._light.appendleft(index)
        elif self._fits_with_no_other(index):
            self._exclusive.appendleft(index)
        else:
            self._heavy.appendleft(index)

    @property
    def is_next_exclusive(self) -> bool:
        """Whether the next task must have the whole machine: it fits beside no other, or it was
        lost once, and the first try may have failed because memory ran out."""
        return bool(self._exclusive) or (not len(self) and bool(self._retries))

    def pop_exclusive(self) -> int:
        """Take the task that must be alone."""
        return (self._exclusive or self._retries).popleft()

    def pop(self, current: Iterable[int], idle_bytes: int) -> int | None:
        """Take a task that may run beside the ``current`` ones; None if none may now.

        ``idle_bytes`` is the memory of idle workers.
        """
        queue = self._beside(current, idle_bytes)
        return queue.popleft() if queue else None

    def may_start(self, current: Iterable[int], idle_bytes: int) -> bool:
        """Whether there is a task for one more worker."""
        return self._beside(current, idle_bytes) is not None

    def _beside(self, current: Iterable[int], idle_bytes: int) -> collections.deque[int] | None:
        beside = list(current)
        used = idle_bytes + sum(map(self.weight, beside))

        def fits(index: int) -> bool:
            # Without a current task anything goes: waiting for others to end would not help.
            return not beside or self._budget is None or used + self.weight(index) <= self._budget

        if self._heavy and fits(self._heavy[0]):
            return self._heavy
        if self._heavy and not any(index in self._weights for index in beside):
            # Only small ones are in its way, and more of them would keep it waiting for ever.
            return None
        return self._light if self._light and fits(self._light[0]) else None

    def _fits_with_no_other(self, index: int) -> bool:
        return self._budget is not None and self.weight(index) + self._light_bytes > self._budget
