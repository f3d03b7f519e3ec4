"""Shards: every file in exactly one, whoever asks, and the systems' variables read right."""

from __future__ import annotations

import hashlib
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.batch.inputs import DiscoveredInput
from msal_cli.batch.plan import build_plan
from msal_cli.batch.shard import MAX_SHARDS, Shard, parse_shard, stable_hash
from msal_cli.errors import UsageError

NAMES = st.text(st.characters(exclude_categories=["Cs"])) | st.binary().map(os.fsdecode)


@given(st.sets(NAMES, max_size=12), st.integers(1, 40))
def test_shards_partition_any_set_of_names(names, count):
    shards = [Shard(number, count) for number in range(1, count + 1)]
    for name in names:
        assert sum(shard.has(name) for shard in shards) == 1


def test_the_hash_is_the_one_that_is_documented():
    digest = hashlib.sha256(b"a/b.ply").hexdigest()
    assert stable_hash("a/b.ply") == int(digest[:16], 16) == 0xC932A85DD84CE496
    assert stable_hash(os.fsdecode(b"\xff.ply")) == stable_hash("\udcff.ply")
    assert stable_hash("\ud800") != stable_hash("\ud801")
    assert Shard(int(digest[:16], 16) % 7 + 1, 7).has("a/b.ply")


def test_a_part_of_a_plan_keeps_the_order_and_knows_the_whole():
    found = [DiscoveredInput(f"in/{n}.ply", f"{n}.ply", "in") for n in range(40)]
    plan = build_plan(found, "out")
    parts = [plan.select_shard(Shard(number, 3)) for number in (1, 2, 3)]
    assert {task for one in parts for task in one.tasks} == set(plan.tasks)
    assert sum(len(one.tasks) for one in parts) == 40
    for one in parts:
        places = [plan.tasks.index(task) for task in one.tasks]
        assert places == sorted(places)
        assert one.whole is plan and one.folders() == ["out"]


@pytest.mark.parametrize("text", ["1/1", "2/4", "4/4", f"{MAX_SHARDS}/{MAX_SHARDS}"])
def test_a_shard_is_what_it_says(text):
    assert str(parse_shard(text, {})) == text


@pytest.mark.parametrize(
    "text",
    ["", "0/4", "5/4", "1", "1/", "-1/4", "1/4/2", "1.0/4", " 1/4", "1/9999999", "auto4", "auto/",
     "auto/0", "\u0661/4", "1/" + "9" * 5000],
)  # fmt: skip
def test_what_is_no_shard_is_refused(text):
    with pytest.raises(UsageError):
        parse_shard(text, {"JOB_COMPLETION_INDEX": "0"})


BATCH = {"SLURM_JOB_ID": "17", "SLURM_PROCID": "0"}


def array(task, lowest=0, step=1, count=4):
    last = lowest + step * (count - 1)
    numbers = {"ID": task, "MIN": lowest, "MAX": last, "STEP": step, "COUNT": count}
    words = {f"SLURM_ARRAY_TASK_{name}": str(number) for name, number in numbers.items()}
    return BATCH | {"SLURM_NTASKS": "1"} | words


AWS = {"AWS_BATCH_JOB_ARRAY_INDEX": "2", "AWS_BATCH_JOB_ARRAY_SIZE": "10"}


@pytest.mark.parametrize(
    ("text", "environment", "expected"),
    [
        ("auto", array(0), "1/4"),
        ("auto", array(9, lowest=3, step=2), "4/4"),
        ("auto/4", array(2) | {"MSAL_SHARDS": "9"}, "3/4"),
        ("auto", {"SLURM_PROCID": "1", "SLURM_NTASKS": "4"}, "2/4"),
        ("auto", BATCH | {"SLURM_STEP_ID": "0", "SLURM_NTASKS": "4"}, "1/4"),
        ("auto", {"SLURM_PROCID": "1", "SLURM_NTASKS": "9", "SLURM_STEP_NUM_TASKS": "2"}, "2/2"),
        ("auto", BATCH | {"SLURM_NTASKS": "1"}, "1/1"),
        ("auto", AWS | {"SLURM_ARRAY_TASK_ID": ""}, "3/10"),
        ("auto/5", {"AWS_BATCH_JOB_ARRAY_INDEX": "2"}, "3/5"),
        ("auto", {"JOB_COMPLETION_INDEX": "0", "MSAL_SHARDS": "5"}, "1/5"),
        ("auto/6", {"JOB_COMPLETION_INDEX": "0", "MSAL_SHARDS": "5"}, "1/6"),
    ],
)
def test_systems_are_understood(text, environment, expected):
    assert str(parse_shard(text, environment)) == expected


@pytest.mark.parametrize(
    ("text", "environment", "words"),
    [
        ("auto", {}, "no variable of"),
        ("auto", {"JOB_COMPLETION_INDEX": "0"}, "how many shards"),
        ("auto/5", {"JOB_COMPLETION_INDEX": "5"}, "none of 5 shards"),
        ("auto/5", {"JOB_COMPLETION_INDEX": "-1"}, "not a whole number"),
        ("auto", {"JOB_COMPLETION_INDEX": "0", "MSAL_SHARDS": "none"}, "MSAL_SHARDS=none"),
        ("auto/9", AWS, "runs 10 processes"),
        ("auto", AWS | {"AWS_BATCH_JOB_ARRAY_INDEX": "10"}, "none of 10 shards"),
        ("auto", AWS | array(0), "different things"),
        # --array=1,2,7 and --array=1,4: places that cannot be counted out
        ("auto", array(7, lowest=1, count=3), "none of 3 shards"),
        ("auto", array(4, lowest=1, step=2, count=2), "none of 2 shards"),
        ("auto", {"SLURM_ARRAY_TASK_ID": "1"}, "SLURM_ARRAY_TASK_MIN"),
        ("auto", {"SLURM_PROCID": "4", "SLURM_NTASKS": "4"}, "none of 4 shards"),
        ("auto", BATCH | {"SLURM_NTASKS": "4"}, "the batch script itself"),
    ],
)
def test_what_does_not_fit_together_is_refused(text, environment, words):
    with pytest.raises(UsageError, match=words) as caught:
        parse_shard(text, environment)
    assert caught.value.hint or "MSAL_SHARDS=" in caught.value.message
