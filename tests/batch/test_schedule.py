"""Which task goes when, and what dead processes leave behind."""

import os
import random
import re
import subprocess
import sys
import time

import pytest

from msal_cli.batch.schedule import TaskQueue, Work
from msal_cli.batch.workers import describe_exit
from msal_cli.machine import is_alive
from msal_cli.storage.atomic import MAX_NAME_BYTES, is_own, sweep, temporary_name
from tests.files import make_files, tree


def queue_of(indices, **weights):
    return TaskQueue(Work(dict.fromkeys(indices), print, None, **weights))


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
    schedule = queue_of(range(4), weights={2: 95, 3: 60}, light_bytes=10, budget_bytes=100)
    assert order(schedule, 4) == [[2, "alone"], 3, 0, 1]


def test_small_ones_do_not_keep_a_large_one_waiting_for_ever():
    schedule = queue_of(range(5), weights={0: 80}, light_bytes=15, budget_bytes=100)
    schedule.pop([], 0)
    schedule.put_back(0)
    assert schedule.pop([1, 2], 0) is None
    assert schedule.pop([2], 0) == 0


def test_a_retried_task_waits_for_all_others_and_goes_alone():
    queue = queue_of(range(3))
    queue.retry(queue.pop([], 0))
    assert order(queue) == [1, 2, [0, "alone"]]


def test_dropped_tasks_are_gone_but_second_tries_stay():
    schedule = queue_of(range(3), weights={0: 9}, budget_bytes=8)
    schedule.retry(schedule.pop_exclusive())
    schedule.drop()
    assert order(schedule) == [[0, "alone"]]


def test_every_task_goes_once_and_never_beyond_the_budget():
    generator = random.Random(0)
    for _ in range(200):
        n, budget = generator.randrange(1, 30), generator.randrange(10, 200)
        weights = {k: generator.randrange(1, 250) for k in range(n) if generator.random() < 0.5}
        schedule = queue_of(range(n), weights=weights, light_bytes=9, budget_bytes=budget)
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


@pytest.fixture(scope="module")
def dead():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def of(pid, stem="a.ply"):
    return temporary_name(stem).replace(f"-{os.getpid()}-", f"-{pid}-")


def test_names_of_our_own():
    assert is_own(temporary_name("a.ply")) and is_own(temporary_name("new\nline"))
    assert is_own(".msal-manifest.jsonl") and is_own(".msal-lock")
    assert not is_own("a.ply") and not is_own(".a.ply") and not is_own("a.msal-1-2.tmp")
    assert temporary_name("a") != temporary_name("a")
    assert len(os.fsencode(temporary_name("x" * 255))) <= MAX_NAME_BYTES


def names_in(folder):
    return list(tree(folder, has_own=True))


def test_what_the_dead_left_goes(tmp_path, dead):
    names = [of(dead), of(dead, "new\nline"), of(dead, "\udcff"), of(dead, "x" * 100)]
    keep = [temporary_name("mine"), of(os.getppid()), "a.ply", ".hidden", ".a.msal-1.tmp"]
    make_files(tmp_path, *names, *keep)
    assert sweep([tmp_path, tmp_path / "missing"]) == 4
    assert names_in(tmp_path) == sorted(keep)


def test_of_another_machine_only_what_is_old_goes(tmp_path, dead):
    names = [re.sub(r"-[0-9a-f]{8}", "-00000000", of(dead, name)) for name in ("new", "old")]
    make_files(tmp_path, *names)
    os.utime(tmp_path / names[1], (0, 0))
    assert sweep([tmp_path]) == 1
    assert sweep([tmp_path], dead) == 0
    assert names_in(tmp_path) == names[:1]


def test_after_a_worker_only_its_own_go(tmp_path, dead):
    names = [of(dead), of(dead + 1), temporary_name("mine")]
    make_files(tmp_path, *names)
    assert sweep([tmp_path], dead) == 1
    assert names_in(tmp_path) == sorted(names[1:])


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="it is read from /proc")
def test_a_process_that_nobody_asked_after_is_dead(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    process.stdout.read()  # until it ends, but without taking its exit status
    deadline = time.monotonic() + 10
    while is_alive(process.pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    make_files(tmp_path, of(process.pid))
    swept = sweep([tmp_path])
    process.stdout.close()
    process.wait()
    assert swept == 1


def test_describe_exits_in_words():
    assert describe_exit(-9) == "was killed by SIGKILL"
    assert describe_exit(-200) == "was killed by signal 200"
    assert describe_exit(3) == "ended with exit status 3"
    assert describe_exit(0xC0000005) == "ended with the exception 0xC0000005"
