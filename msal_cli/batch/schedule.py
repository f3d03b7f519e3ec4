"""Which task is handed out next: large ones first and never more at once than memory holds.

Nothing here starts or waits for anything; ``workers.Crew`` asks, and does.
"""

from __future__ import annotations

import collections
from collections.abc import Iterable, Mapping


class Schedule:
    """The tasks that are yet to be handed out.

    Parameters
    ----------
    tasks : indices, in the order of the plan.
    weights : bytes of memory that the large ones among them are foreseen to take at their peak.
        They go first, heaviest first, so that none is left to run alone at the end.
    light_bytes : what any other is taken to need.
    budget_bytes : what all tasks in hand may take together; None is no bound.
    retries : how often a task that was lost with its worker is tried again.
    """

    def __init__(
        self,
        tasks: Iterable[int],
        *,
        weights: Mapping[int, int] | None = None,
        light_bytes: int = 0,
        budget_bytes: int | None = None,
        retries: int = 1,
    ) -> None:
        self._weights = dict(weights or {})
        self._light_bytes = light_bytes
        self._budget = budget_bytes
        self._retries = retries
        self._losses: collections.Counter[int] = collections.Counter()
        indices = list(tasks)
        heavy = [index for index in indices if index in self._weights]
        heavy.sort(key=lambda index: -self._weights[index])
        self._lonely = collections.deque(filter(self._fits_with_no_other, heavy))
        self._heavy = collections.deque(heavy[len(self._lonely) :])
        self._light = collections.deque(index for index in indices if index not in self._weights)
        self._again: collections.deque[int] = collections.deque()

    def __len__(self) -> int:
        """How many tasks wait for their first try."""
        return len(self._lonely) + len(self._heavy) + len(self._light)

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits, second tries included."""
        return not len(self) and not self._again

    def extend(self, tasks: Iterable[int]) -> None:
        """Let more tasks wait, behind all others."""
        self._light.extend(tasks)

    def forget(self) -> None:
        """Forget how often tasks were lost; their numbers may be used anew."""
        self._losses.clear()

    def drop(self) -> None:
        """Give up the tasks that wait for their first try."""
        for some in (self._lonely, self._heavy, self._light):
            some.clear()

    def weight(self, index: int) -> int:
        """Bytes that a task is taken to need."""
        return self._weights.get(index, self._light_bytes)

    def lose(self, index: int) -> bool:
        """Note that a task was lost; whether it waits to be tried again."""
        self._losses[index] += 1
        if self._losses[index] > self._retries:
            return False
        self._again.append(index)
        return True

    def losses(self, index: int) -> int:
        """How often a task was lost so far."""
        return self._losses[index]

    def put_back(self, index: int) -> None:
        """A task that was taken did not reach its worker: it is next again."""
        if self._losses[index]:
            self._again.appendleft(index)
        elif index not in self._weights:
            self._light.appendleft(index)
        elif self._fits_with_no_other(index):
            self._lonely.appendleft(index)
        else:
            self._heavy.appendleft(index)

    @property
    def is_next_alone(self) -> bool:
        """Whether the next task must have the whole machine: it fits beside no other, or it was
        lost once and the first try may have failed for want of memory."""
        return bool(self._lonely) or (not len(self) and bool(self._again))

    def taken_alone(self) -> int:
        """Take the task that must be alone."""
        return (self._lonely or self._again).popleft()

    def taken(self, in_hand: Iterable[int], held_bytes: int) -> int | None:
        """Take a task that may run beside those ``in_hand``; None if none may now.

        ``held_bytes`` is what idle workers hold.
        """
        some = self._beside(in_hand, held_bytes)
        return some.popleft() if some else None

    def may_start(self, in_hand: Iterable[int], held_bytes: int) -> bool:
        """Whether there is a task for one more worker."""
        return self._beside(in_hand, held_bytes) is not None

    def _beside(self, in_hand: Iterable[int], held_bytes: int) -> collections.deque[int] | None:
        beside = list(in_hand)
        taken = held_bytes + sum(map(self.weight, beside))

        def fits(index: int) -> bool:
            # Alone in hand anything goes: waiting for others to end would not help.
            return not beside or self._budget is None or taken + self.weight(index) <= self._budget

        if self._heavy and fits(self._heavy[0]):
            return self._heavy
        if self._heavy and not any(index in self._weights for index in beside):
            # Only small ones are in its way, and more of them would keep it waiting for ever.
            return None
        return self._light if self._light and fits(self._light[0]) else None

    def _fits_with_no_other(self, index: int) -> bool:
        return self._budget is not None and self.weight(index) + self._light_bytes > self._budget
