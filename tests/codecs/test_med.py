"""MED files, which h5py reads for us in a process that can open nothing else."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from msal_cli.codecs import library_guard as guard
from msal_cli.codecs import med, open_mesh
from msal_cli.codecs import med_sandbox as confined
from msal_cli.errors import MsalError
from tests.codecs.patching import patched
from tests.shapes import torus

VERTICES, FACES = torus(12, 8)


@pytest.fixture
def h5py():
    return pytest.importorskip("h5py")


def build(h5py, path, points=None, **options) -> bytes:
    """A MED file as meshio writes it; ``points(group)`` makes the data set of the points."""
    with h5py.File(path, "w") as file:
        mesh = file.create_group("ENS_MAA/mesh")
        mesh.attrs["ESP"] = options.get("dimension", 3)
        step = mesh.create_group(options.get("step", "-1"))
        nodes = step.create_group("NOE")
        columns = VERTICES.T.reshape(-1)
        if points:
            points(nodes, columns)
        else:
            nodes.create_dataset("COO", data=columns).attrs["NBR"] = len(VERTICES)
        corners = (FACES + 1 + options.get("shift", 0)).T.reshape(-1)
        step.create_dataset(f"MAI/{options.get('kind', 'TR3')}/NOD", data=corners)
        step.create_dataset("MAI/SE2/NOD", data=np.array([1, 2, 2, 3]))
        for cells, count in (("SE2", 2), (options.get("kind", "TR3"), len(FACES))):
            step[f"MAI/{cells}/NOD"].attrs["NBR"] = count
        file.create_group("FAS/mesh")
        if "field" in options:
            file.create_group("CHA/temperature")
    return path.read_bytes()


def test_everything_but_positions_stays(h5py, tmp_path):
    data = build(h5py, tmp_path / "a.med")
    file, moved, output = patched(data, "a.med")
    assert np.array_equal(file.vertices, VERTICES)
    assert np.array_equal(file.faces, FACES)
    columns = VERTICES.T.tobytes()
    assert output == data.replace(columns, moved.T.tobytes())
    import meshio

    (tmp_path / "b.med").write_bytes(output)
    assert np.array_equal(meshio.read(tmp_path / "b.med").points, moved)


def test_fields_are_named(h5py, tmp_path):
    file = open_mesh(build(h5py, tmp_path / "a.med", field=True), "a.med")
    assert file.properties == ("field temperature",)


def external(tmp_path):
    def points(group, columns):
        path = tmp_path / "secret.bin"
        path.write_bytes(columns.tobytes())
        group.create_dataset("COO", columns.shape, "f8", external=[(str(path), 0, columns.nbytes)])

    return points


def linked(tmp_path):
    def points(group, columns):
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "secret.h5", "w") as other:
            other["x"] = columns
        group["COO"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "x")

    return points


def virtual(tmp_path):
    def points(group, columns):
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "secret.h5", "w") as other:
            other["x"] = columns
        layout = h5py.VirtualLayout(columns.shape, "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "x", columns.shape)
        group.create_virtual_dataset("COO", layout)

    return points


def soft(tmp_path):
    def points(group, columns):
        h5py = pytest.importorskip("h5py")
        group["COO"] = h5py.SoftLink("/ENS_MAA")

    return points


def packed(tmp_path):
    return lambda group, columns: group.create_dataset("COO", data=columns, compression="gzip")


@pytest.mark.parametrize("points", [external, linked, virtual, soft, packed])
def test_numbers_that_are_not_in_the_file_as_they_are(h5py, tmp_path, points):
    data = build(h5py, tmp_path / "a.med", points(tmp_path))
    with pytest.raises(MsalError) as caught:
        open_mesh(data, "a.med")
    assert caught.value.code == "E_UNSUPPORTED"
    wanted = {
        external: "another file",
        linked: "somewhere else",
        virtual: "another file",
        soft: "somewhere else",
        packed: "compressed or in pieces",
    }
    assert wanted[points] in str(caught.value)


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"dimension": 2}, "E_UNSUPPORTED"),
        ({"kind": "TR6"}, "E_UNSUPPORTED"),
        ({"kind": "POG"}, "E_UNSUPPORTED"),
        ({"kind": "TE4"}, "E_NO_FACES"),
        ({"shift": 90}, "E_INDEX"),
    ],
)
def test_damage(h5py, tmp_path, options, code):
    with pytest.raises(MsalError) as caught:
        open_mesh(build(h5py, tmp_path / "a.med", **options), "a.med")
    assert caught.value.code == code


def test_broken_files(h5py, tmp_path):
    data = build(h5py, tmp_path / "a.med")
    for broken, code in ((data[:200], "E_FORMAT"), (b"HDF", "E_FORMAT"), (data[:8], "E_FORMAT")):
        with pytest.raises(MsalError) as caught:
            open_mesh(broken, "a.med")
        assert caught.value.code == code
        assert "/tmp" not in str(caught.value)


def test_the_package_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setattr(med.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MsalError, match="h5py") as caught:
        open_mesh(b"\x89HDF\r\n\x1a\n", "a.med")
    assert caught.value.code == "E_UNSUPPORTED"
    assert "pip install h5py" in caught.value.hint


PROBE = """
import importlib.util, json, sys, tempfile
spec = importlib.util.spec_from_file_location("child", sys.argv[1])
child = importlib.util.module_from_spec(spec)
spec.loader.exec_module(child)
import ctypes, socket, os, h5py, _posixsubprocess
c_open = ctypes.CDLL(None, use_errno=True).open
child._confine(1000, 5)
said = {}
for name, call in {
    "open": lambda: open(sys.argv[1]),
    "os.open": lambda: os.open(sys.argv[1], os.O_RDONLY),
    "socket": lambda: socket.socket(),
    "system": lambda: os.system("true"),
    "hdf5": lambda: h5py.File(sys.argv[2], "r"),
    "memory": lambda: bytes(8 << 30),
}.items():
    try:
        call()
        said[name] = "done"
    except (OSError, MemoryError) as failure:
        said[name] = type(failure).__name__
said["c"] = c_open(sys.argv[1].encode(), 0)
sys.stdout.write(json.dumps(said))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of the system")
def test_the_process_can_open_nothing(h5py, tmp_path):
    build(h5py, tmp_path / "a.med")
    script = Path(med.__file__).with_name("med_child.py")
    done = subprocess.run(
        [sys.executable, "-c", PROBE, str(script), str(tmp_path / "a.med")],
        capture_output=True,
        check=True,
    )
    said = json.loads(done.stdout)
    assert said.pop("memory") == "MemoryError"
    assert said.pop("c") == -1
    assert set(said.values()) <= {"PermissionError", "OSError", "BlockingIOError"}, said


ENDLESS = "import time\nwhile True: time.sleep(1)\n"


def test_a_reader_that_hangs_or_dies_is_ended_with_its_process(tmp_path, monkeypatch):
    monkeypatch.setattr(guard, "LEAST_S", 0.5)
    real = confined.Path(confined.__file__)
    for text, code in ((ENDLESS, "E_TIMEOUT"), ("import os\nos.abort()\n", "E_FORMAT")):
        (tmp_path / "child.py").write_text(text)
        monkeypatch.setattr(confined, "__file__", str(tmp_path / real.name))
        with pytest.raises(MsalError, match="MED") as caught:
            confined.answer_of("child", b"x", "med")
        assert caught.value.code == code


def test_ply_needs_no_such_process(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError

    monkeypatch.setattr(subprocess, "run", refuse)
    from tests.codecs.test_off import off

    assert open_mesh(off(), "a.off").faces.shape == (4, 3)
    assert importlib.util.find_spec("msal_cli.codecs.med_sandbox")
