"""msal noise and denoise --fields: what they write, and what they refuse."""

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.job import fields
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, ply_text, record_of
from tests.codecs import plain_ply
from tests.codecs.patching import changed_lines
from tests.files import tree
from tests.shapes import ball, torus


@pytest.mark.parametrize("kind", ["gaussian", "view"])
def test_only_positions_change(scan, kind):
    target = scan.with_name("out.ply")
    made = msal("noise", scan, "-o", target, "--kind", kind, "--level", "0.3", "--seed", 5)
    assert (made.exit_code, made.stdout) == (0, "")
    assert f"{kind} noise of 0.3 mean edge lengths" in made.stderr
    before = scan.read_bytes()
    changed = changed_lines(before, target.read_bytes())
    start = before.splitlines().index(b"end_header") + 1
    assert changed
    assert all(start <= at < start + 576 for at in changed)


def test_a_folder_becomes_a_mirrored_tree(tmp_path):
    folder = folder_of(tmp_path / "in", a=closed_scan(), bad=BAD_SCAN)
    folder_of(folder / "below", b=closed_scan(1))
    made = msal("noise", folder, "-o", tmp_path / "out", "--seed", 3)
    assert made.exit_code == 3
    assert "bad.ply" in made.stderr
    assert list(tree(tmp_path / "out")) == ["a.ply", "below/b.ply"]
    again = msal("noise", folder, "-o", tmp_path / "out", "--seed", 3)
    assert (again.exit_code, "--force" in again.stderr) == (2, True)


def test_noise_beyond_the_numbers_of_the_file_asks_for_a_lower_level(tmp_path):
    text = ply_text(*torus()).decode().splitlines()
    start = text.index("end_header") + 1
    for at in range(start, start + 288):
        text[at] = " ".join(str(1e38 * float(word)) for word in text[at].split())
    (tmp_path / "far.ply").write_text("\n".join(text) + "\n")
    made = msal("noise", tmp_path / "far.ply", "-o", tmp_path / "out.ply", "--level", "20")
    assert (made.exit_code, (tmp_path / "out.ply").exists()) == (1, False)
    assert "choose a lower --level" in made.stderr
    assert "--precision" not in made.stderr


ALL = ",".join(fields.KINDS)


def table(path):
    """The columns of the vertices of a PLY, by name."""
    vertex = plain_ply.read(path.read_bytes()).element("vertex")
    names = [name for name, *_ in vertex.properties]
    return dict(zip(names, np.array(vertex.rows).T, strict=True))


def test_the_fields_of_a_file(scan, tmp_path):
    output = tmp_path / "out.ply"
    made = msal("denoise", scan, "-o", output, "--method", "msal", "--fields", ALL, "--json")
    entry = record_of(made)["fields"]
    assert entry["path"] == str(tmp_path / "out.fields.ply")
    assert (entry["names"], entry["coloured"]) == (list(fields.KINDS), "lambda")
    rows = table(tmp_path / "out.fields.ply")
    assert rows["lambda"] == pytest.approx(rows["sigma"] / rows["sigma"].max(), rel=1e-6)
    before = codecs.open_mesh(scan.read_bytes(), "a.ply").vertices
    after = codecs.open_mesh(output.read_bytes(), "a.ply")
    moves = np.linalg.norm(after.vertices - before, axis=1)
    assert np.abs(rows["displacement"]) == pytest.approx(moves, abs=2e-6)
    with_fields = codecs.open_mesh((tmp_path / "out.fields.ply").read_bytes(), "a.ply")
    assert with_fields.vertices == pytest.approx(after.vertices, abs=1e-6)
    assert np.array_equal(with_fields.faces, after.faces)


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
