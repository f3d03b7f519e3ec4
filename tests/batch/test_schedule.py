"""Who is handed out when, by hand-worked cases without any process."""

from __future__ import annotations

import random

import pytest

from msal_cli.batch.schedule import Failed, Losses, Retried, TaskQueue


def order(schedule, at_once=1):
    """The tasks in the order in which they go, ``at_once`` in hand, oldest ending first."""
    gone, current_task = [], []
    while not schedule.is_empty or current_task:
        if schedule.is_next_exclusive and not current_task:
            current_task.append(schedule.pop_exclusive())
            gone.append([current_task[-1], "alone"])
        elif not schedule.is_next_exclusive and len(current_task) < at_once:
            index = schedule.pop(current_task, 0)
            if index is not None:
                current_task.append(index)
                gone.append(index)
                continue
        current_task.pop(0)
    return gone


def test_what_fits_beside_no_other_goes_alone_and_before_all():
    schedule = TaskQueue(range(4), weights={2: 95, 3: 60}, light_bytes=10, budget_bytes=100)
    assert order(schedule, 4) == [[2, "alone"], 3, 0, 1]


def test_small_ones_do_not_keep_a_large_one_waiting_for_ever():
    schedule = TaskQueue(range(5), weights={0: 80}, light_bytes=15, budget_bytes=100)
    schedule.pop([], 0)
    schedule.put_back(0)
    assert schedule.pop([1, 2], 0) is None
    assert schedule.pop([2], 0) == 0


@pytest.mark.parametrize("retries", [0, 1, 3])
def test_a_lost_task_is_retried_so_often_and_then_failed(retries):
    losses = Losses(retries)
    for _ in range(retries):
        assert losses.add(7, "crash", "it died", "hint") == Retried(7, "it died")
        assert losses.reasons == {7: "it died"}
    ending = {0: "", 1: ", as at the first try", 3: " (4 tries)"}[retries]
    assert losses.add(7, "crash", "it died", "hint") == Failed(
        7, "crash", "it died" + ending, "hint"
    )


def test_a_retried_task_waits_for_all_others_and_goes_alone():
    queue = TaskQueue(range(3))
    queue.retry(queue.pop([], 0))
    assert order(queue) == [1, 2, [0, "alone"]]


def test_dropped_tasks_are_gone_but_second_tries_stay():
    schedule = TaskQueue(range(3), weights={0: 9}, budget_bytes=8)
    schedule.retry(schedule.pop_exclusive())
    schedule.drop()
    assert order(schedule) == [[0, "alone"]]


def test_every_task_goes_once_and_never_beyond_the_budget():
    generator = random.Random(0)
    for _ in range(200):
        n, budget = generator.randrange(1, 30), generator.randrange(10, 200)
        weights = {k: generator.randrange(1, 250) for k in range(n) if generator.random() < 0.5}
        schedule = TaskQueue(range(n), weights=weights, light_bytes=9, budget_bytes=budget)
        done, current_task = [], []
        while not schedule.is_empty or current_task:
            if schedule.is_next_exclusive:
                index = None if current_task else schedule.pop_exclusive()
            else:
                index = schedule.pop(current_task, 0)
            if index is None:
                current_task.remove(generator.choice(current_task))
                continue
            current_task.append(index)
            done.append(index)
            taken = sum(map(schedule.weight, current_task))
            assert taken <= budget or len(current_task) == 1
        assert sorted(done) == list(range(n))
