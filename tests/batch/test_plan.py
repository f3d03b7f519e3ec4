"""Where outputs go, and what is refused before anything is touched."""

import json
from pathlib import Path

import pytest

from msal_cli.batch import plan as planning
from msal_cli.batch.inputs import DiscoveredInput, discover_inputs
from msal_cli.batch.manifest import NAME
from msal_cli.batch.plan import build_plan, manifest_key
from msal_cli.errors import UsageError
from tests.files import make_files, posix, tree

OWN = (NAME, ".msal-lock")


def planned(inputs, output, **options):
    some = discover_inputs([str(one) for one in inputs])
    return build_plan(some, None if output is None else str(output), **options)


def outputs(folder, *arguments, **options):
    return [
        Path(task.output).relative_to(folder).as_posix()
        for task in planned(*arguments, **options).tasks
    ]


@pytest.fixture
def refuses(tmp_path):
    """A call that must raise UsageError with all these words and leave the disk as it was."""

    def check(words, *arguments, **options):
        before = tree(tmp_path, has_own=True)
        with pytest.raises(UsageError) as caught:
            planned(*arguments, **options)
        for word in words:
            assert word in caught.value.message, caught.value.message
        assert tree(tmp_path, has_own=True) == before
        return caught.value

    return check


def test_a_folder_is_mirrored(tmp_path):
    make_files(tmp_path, "in/a.ply", "in/b/c.obj.gz")
    plan = planned([tmp_path / "in"], tmp_path / "out")
    assert [task.output for task in plan.tasks] == [
        str(tmp_path / "out/a.ply"),
        str(tmp_path / "out/b/c.obj.gz"),
    ]
    assert {task.manifest_dir for task in plan.tasks} == {str(tmp_path / "out")}
    assert list(map(manifest_key, plan.tasks)) == ["a.ply", "b/c.obj.gz"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("output", "existing", "expected"),
    [
        ("out.ply", (), "out.ply"),
        ("new/out.ply", (), "new/out.ply"),
        ("out.ply", ("out.ply",), "out.ply"),
        ("out", ("out",), "out"),
        ("out", (), "out/a.ply"),
        ("out.ply/", (), "out.ply/a.ply"),
        ("out.ply", ("out.ply/x",), "out.ply/a.ply"),
        ("out", ("out/x",), "out/a.ply"),
    ],
)
def test_one_file_goes_to_a_file_or_into_a_folder(tmp_path, output, existing, expected):
    make_files(tmp_path, "in/a.ply", *existing)
    plan = planned([tmp_path / "in/a.ply"], f"{tmp_path}/{output}")
    assert plan.tasks[0].output == f"{tmp_path}/{expected}"
    assert (plan.tasks[0].manifest_dir is None) == (not expected.endswith("/a.ply"))


@pytest.mark.parametrize("output", ["y.gz", "y.stp.gz"])
def test_an_unknown_suffix_of_a_single_output_is_refused(tmp_path, refuses, output):
    make_files(tmp_path, "in/a.ply")
    error = refuses(["no mesh format", "ply, obj, stl"], [tmp_path / "in/a.ply"], output)
    assert f"{output}/" in error.hint
    # Also over a file that is there; a folder may be called so.
    make_files(tmp_path, output)
    refuses(["no mesh format"], [tmp_path / "in/a.ply"], tmp_path / output)
    folder = f"{tmp_path}/new-{output}/"
    assert outputs(tmp_path, [tmp_path / "in/a.ply"], folder) == [f"new-{output}/a.ply"]
    make_files(tmp_path, "b.stp/x")
    assert outputs(tmp_path, [tmp_path / "in/a.ply"], tmp_path / "b.stp") == ["b.stp/a.ply"]


def test_the_word_to_must_not_contradict_the_output(tmp_path, refuses):
    make_files(tmp_path, "a.ply")
    refuses(["--to obj", "b.stl"], [tmp_path / "a.ply"], tmp_path / "b.stl", to="obj")
    assert outputs(tmp_path, [tmp_path / "a.ply"], tmp_path / "b.STL", to="stl") == ["b.STL"]


@pytest.mark.parametrize(
    ("files", "inputs", "output", "options", "words"),
    [
        ("a.ply", "a.ply", None, {}, "no output"),
        ("a.ply b.ply", "a.ply b.ply", "two.ply", {}, "called like one mesh file"),
        # Two inputs with one output, also after a change of suffix.
        ("one/a.ply two/a.ply", "one/a.ply two/a.ply", "out", {}, "{}/one/a.ply {}/two/a.ply both"),
        ("in/a.ply in/a.obj", "in", "out", {"to": "stl"}, "a.ply a.obj both"),
        # A file and a folder of one name.
        ("in/a.ply two/a.ply/b.ply", "in/a.ply two", "out", {}, "file folder {}/in/a.ply b.ply"),
        ("in/a.obj/b.ply in/a.ply", "in", "out", {"to": "obj"}, "file folder"),
        # Another input of the run.
        (
            "one/a.ply out/one/a.ply out/b.ply",
            "one out",
            "out",
            {"force": True},
            "overwrite input one/a.ply {}/out/one/a.ply",
        ),
        # Places that cannot be.
        ("in/a.ply out/a.ply/x", "in", "out", {"force": True}, "is the folder"),
        ("in/b/a.ply out/b", "in", "out", {"force": True}, "is a file"),
        ("in/b/a.ply file", "in", "file", {}, "is a file"),
        # Names of what msal keeps.
        *((f"in/{name} a.ply", f"in/{name} a.ply", "out", {}, "msal's own") for name in OWN),
        *((f"in/{name}", f"in/{name}", None, {"in_place": True}, "msal's own") for name in OWN),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, refuses, files, inputs, output, options, words):
    make_files(tmp_path, *files.split())
    some = [tmp_path / one for one in inputs.split()]
    target = None if output is None else tmp_path / output
    refuses(words.format(tmp_path, tmp_path).split(), some, target, **options)


@posix
@pytest.mark.parametrize(
    "twins", [("a.ply", "A.ply"), ("s/x.ply", "S/y.ply"), ("\u00e9.ply", "e\u0301.ply")]
)
def test_case_only_twins_are_refused_where_the_file_system_tells_them_not_apart(
    tmp_path, refuses, monkeypatch, twins
):
    make_files(tmp_path, *(f"in/{name}" for name in twins))
    if "a.ply" in twins:
        assert outputs(tmp_path, [tmp_path / "in"], tmp_path / "out") == ["out/A.ply", "out/a.ply"]
    probed = []
    monkeypatch.setattr(planning, "ignores_case", lambda folder: probed.append(folder) or True)
    if "/" in twins[0]:
        assert len(outputs(tmp_path, [tmp_path / "in"], tmp_path / "out")) == 2
    else:
        refuses(["case does not count"], [tmp_path / "in"], tmp_path / "out")
        assert probed == [tmp_path]


def test_a_folder_or_a_file_onto_itself(tmp_path, refuses, monkeypatch):
    make_files(tmp_path, "in/a.ply", "sub/x")
    refuses(["overwritten by its own output"], [tmp_path / "in"], tmp_path / "in")
    assert outputs(tmp_path, [tmp_path / "in"], tmp_path / "in", to="stl") == ["in/a.stl"]
    monkeypatch.chdir(tmp_path)
    refuses(["own output", "sub/../in/a.ply"], ["in/a.ply"], "sub/../in/a.ply")


@posix
@pytest.mark.parametrize("kind", ["symbolic", "hard"])
def test_a_file_onto_itself_through_a_link(tmp_path, refuses, kind):
    make_files(tmp_path, "in/a.ply", "out/x")
    link = tmp_path / "out/a.ply"
    (link.hardlink_to if kind == "hard" else link.symlink_to)(tmp_path / "in/a.ply")
    refuses(["own output"], [tmp_path / "in"], tmp_path / "out", force=True)
    refuses(["own output"], [tmp_path / "in/a.ply"], link)


class TestForeignFiles:
    def test_a_file_that_no_run_wrote_is_not_overwritten(self, tmp_path, refuses):
        make_files(tmp_path, *(f"in/{name}.ply" for name in "abcde"))
        make_files(tmp_path, *(f"out/{name}.ply" for name in "abcde"))
        error = refuses(["a.ply", "and 2 more"], [tmp_path / "in"], tmp_path / "out")
        assert "--force" in error.hint
        assert len(outputs(tmp_path, [tmp_path / "in"], tmp_path / "out", force=True)) == 5

    @pytest.mark.parametrize("kind", ["intent", "done"])
    def test_a_file_of_an_earlier_run_may_be(self, tmp_path, refuses, kind):
        make_files(tmp_path, "in/a.ply", "in/b.ply", "out/a.ply", "out/b.ply")
        line = {"kind": kind, "name": "a.ply", "format": 1, "settings": "", "status": "written"}
        line |= {"input": {"sha256": ""}, "output": None, "record": {}}
        (tmp_path / "out" / NAME).write_text(json.dumps(line) + "\n")
        error = refuses(["b.ply"], [tmp_path / "in"], tmp_path / "out")
        assert "a.ply" not in error.message
        (tmp_path / "out/b.ply").unlink()
        assert len(outputs(tmp_path, [tmp_path / "in"], tmp_path / "out")) == 2


class TestPlacesThatCannotBe:
    @pytest.mark.parametrize("relative", ["../a.ply", "b/../../a.ply", "/etc/a.ply"])
    def test_a_relative_path_that_climbs(self, tmp_path, relative):
        make_files(tmp_path, "a.ply")
        with pytest.raises(UsageError, match="no path below"):
            build_plan(
                [DiscoveredInput(str(tmp_path / "a.ply"), relative, str(tmp_path))],
                str(tmp_path / "out"),
            )

    @posix
    def test_a_link_that_leads_out_of_the_output_folder(self, tmp_path, refuses):
        make_files(tmp_path, "in/b/a.ply", "out/x", "elsewhere/y")
        (tmp_path / "out/b").symlink_to(tmp_path / "elsewhere")
        refuses(["leave the output folder", "elsewhere"], [tmp_path / "in"], tmp_path / "out")
        (tmp_path / "link").symlink_to("elsewhere")
        assert outputs(tmp_path, [tmp_path / "in"], tmp_path / "link") == ["link/b/a.ply"]


class TestInPlace:
    def test_the_output_is_the_input(self, tmp_path):
        make_files(tmp_path, "in/a.ply", "in/b/c.ply")
        plan = planned([tmp_path / "in"], None, in_place=True)
        assert all(task.in_place and task.input == task.output for task in plan.tasks)
        assert [task.backup for task in plan.tasks] == [".orig", ".orig"]
        assert plan.folders() == [str(tmp_path / "in")]
        assert manifest_key(plan.tasks[1]) == "b/c.ply"
        assert planned([tmp_path / "in"], None, in_place=True, backup=None).tasks[0].backup is None

    def test_what_makes_no_sense_is_refused(self, tmp_path, refuses):
        make_files(tmp_path, "a.ply")
        one = [tmp_path / "a.ply"]
        refuses(["both given"], one, tmp_path / "out", in_place=True)
        refuses(["change the format"], one, None, in_place=True, to="obj")
        for backup in ("", "/x", "\0"):
            refuses(["suffix of a backup"], one, None, in_place=True, backup=backup)
        for backup in (".ply", ".gz", "-old.obj"):
            refuses(["inputs of the next run"], one, None, in_place=True, backup=backup)

    @posix
    def test_a_link_stays_a_link_and_counts_once(self, tmp_path):
        make_files(tmp_path, "in/a.ply", "in/real/b.ply")
        (tmp_path / "in/b.ply").symlink_to("a.ply")
        plan = planned([tmp_path / "in"], None, in_place=True)
        assert sorted(task.output for task in plan.tasks) == [
            str(tmp_path / "in/a.ply"),
            str(tmp_path / "in/real/b.ply"),
        ]

    @posix
    def test_a_file_out_of_the_tree_is_not_changed_through_a_link(self, tmp_path, refuses):
        make_files(tmp_path, "in/a.ply", "store/b.ply")
        (tmp_path / "in/b.ply").symlink_to(tmp_path / "store/b.ply")
        refuses(["leads out of", "store"], [tmp_path / "in"], None, in_place=True)
        named = planned([tmp_path / "in/b.ply"], None, in_place=True)
        assert named.tasks[0].output == str(tmp_path / "store/b.ply")
