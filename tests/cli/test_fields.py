"""`msal denoise --fields`: numbers at the vertices in a PLY beside the output."""

from __future__ import annotations

import json

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from msal_cli import codecs
from msal_cli.job.fields import KINDS
from tests.cli.scans import closed_scan, folder_of, msal, ply_text
from tests.report.schemas import report_schema
from tests.shapes import ball

ALL = ",".join(KINDS)


@pytest.fixture
def scan(tmp_path):
    return folder_of(tmp_path / "in", scan=closed_scan()) / "scan.ply"


def table(path):
    """The columns of the vertices of a binary PLY, by name."""
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    types = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    lines = [line.split() for line in head.decode().splitlines()]
    names = [
        (word[2], types[word[1]]) for word in lines if word[0] == "property" and len(word) == 3
    ]
    count = next(int(word[2]) for word in lines if word[:2] == ["element", "vertex"])
    return np.frombuffer(body, dtype=names, count=count)


def test_the_fields_of_a_file(scan, tmp_path):
    output = tmp_path / "out.ply"
    made = msal("denoise", scan, "-o", output, "--method", "msal", "--fields", ALL, "--json")
    assert made.exit_code == 0
    data = json.loads(made.stdout)
    Draft202012Validator(report_schema()).validate(data)
    told = data["records"][0]["fields"]
    assert told["path"] == str(tmp_path / "out.fields.ply")
    assert (told["names"], told["coloured"]) == (list(KINDS), "lambda")
    rows = table(tmp_path / "out.fields.ply")
    assert rows["lambda"] == pytest.approx(rows["sigma"] / rows["sigma"].max(), rel=1e-6)
    before = codecs.open_mesh(scan.read_bytes(), "a.ply").vertices
    after = codecs.open_mesh(output.read_bytes(), "a.ply")
    moves = np.linalg.norm(after.vertices - before, axis=1)
    assert np.abs(rows["displacement"]) == pytest.approx(moves, abs=2e-6)
    with_fields = codecs.open_mesh((tmp_path / "out.fields.ply").read_bytes(), "a.ply")
    assert with_fields.vertices == pytest.approx(after.vertices, abs=1e-6)
    assert np.array_equal(with_fields.faces, after.faces)


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("displacement", "map diverging, blue over pale to brown for displacement -"),
        ("sigma", "map sequential, pale to dark for sigma 0 to "),
    ],
)
def test_the_header_says_what_the_colours_mean(scan, tmp_path, field, words):
    msal("denoise", scan, "-o", tmp_path / "a.ply", "--fields", field)
    head = (tmp_path / "a.fields.ply").read_bytes().partition(b"end_header")[0].decode()
    assert f"comment colours: {words}" in head
    assert f"comment {field}: {KINDS[field].meaning}; " in head


def test_a_folder_and_a_rerun(scan, tmp_path):
    folder_of(scan.parent / "below", other=closed_scan(1))
    given = ("denoise", scan.parent, "-o", tmp_path / "out", "--fields", "sigma")
    assert msal(*given).exit_code == 0
    written = sorted(one.name for one in (tmp_path / "out").rglob("*.fields.ply"))
    assert written == ["other.fields.ply", "scan.fields.ply"]
    assert "2 up to date" in msal(*given).stderr.replace("up-to-date", "up to date")
    assert msal(*given[:-1], "lambda,sigma").exit_code == 0
    assert "lambda" in table(tmp_path / "out" / "scan.fields.ply").dtype.names


def test_a_file_of_somebody_else_is_not_replaced(scan, tmp_path):
    theirs = tmp_path / "a.fields.ply"
    theirs.write_bytes(b"mine")
    made = msal("denoise", scan, "-o", tmp_path / "a.ply", "--fields", "sigma")
    assert made.exit_code == 1
    assert theirs.read_bytes() == b"mine"
    assert not (tmp_path / "a.ply").exists()


def test_outward_is_away_from_the_solid_where_the_surface_is_inside_out(tmp_path):
    vertices, faces = ball()
    for name, one in (("plain", faces), ("turned", faces[:, ::-1])):
        scan, output = tmp_path / f"{name}.ply", tmp_path / f"{name}_out.ply"
        scan.write_bytes(ply_text(vertices, one))
        given = ("--method", "umbrella", "--fields", "displacement,curvature")
        assert msal("denoise", scan, "-o", output, *given).exit_code == 0
    plain, turned = (table(tmp_path / f"{one}_out.fields.ply") for one in ("plain", "turned"))
    for name in ("displacement", "curvature"):
        assert turned[name] == pytest.approx(plain[name], abs=1e-6)
    assert turned["displacement"].mean() < 0.0
    assert turned["curvature"].mean() > 0.0
