"""Materials and textures beside the output."""

import os
import re

import pytest

from msal_cli.errors import OutputError
from msal_cli.storage import sidecars
from msal_cli.storage.sidecars import carry
from tests.files import posix, tree


@pytest.fixture
def scene(tmp_path):
    """A folder with a mesh, its library and three textures, and the path of the output."""
    folder = tmp_path / "in"
    (folder / "tex").mkdir(parents=True)
    (folder / "mesh.obj").write_bytes(b"mtllib mesh.mtl\n")
    (folder / "mesh.mtl").write_bytes(
        b"newmtl skin\r\nKd 1 1 1\r\nmap_Kd -o 1 2 -s 1 1 1 -clamp on tex/colour map.png\r\n"
        b"\tbump -bm 0.5 tex/bump.png\nmap_Bump tex\\back.png\nnorm missing.png\n# map_Ka no.png\n"
    )
    for k, name in enumerate(("colour map.png", "bump.png", "back.png")):
        (folder / "tex" / name).write_bytes(bytes([k]) * 100)
    return folder / "mesh.obj", tmp_path / "out" / "mesh.obj"


def test_the_library_and_its_textures_come_along(scene):
    source, target = scene
    notes = carry(["mesh.mtl"], source, target)
    beside = {name: data for name, data in tree(source.parent).items() if name != source.name}
    assert tree(target.parent) == beside
    assert notes == (
        "copied mesh.mtl",
        "copied tex/colour map.png",
        "copied tex/bump.png",
        "copied tex\\back.png",
        "warning: missing.png is missing beside the input",
    )


@pytest.mark.parametrize("name", ["mesh.mtl", "tex/bump.png"])
def test_a_different_file_is_overwritten_by_force_only(scene, name):
    source, target = scene
    place = target.parent / name
    place.parent.mkdir(parents=True)
    # Size and time alone do not make files the same.
    source_of_it = source.parent / name
    another = b"x" * source_of_it.stat().st_size
    place.write_bytes(another)
    for path in (place, source_of_it):
        os.utime(path, (1e9, 1e9))
    with pytest.raises(OutputError) as caught:
        carry(["mesh.mtl"], source, target)
    assert caught.value.code == "E_SIDECAR"
    assert "separate output folders" in caught.value.hint
    assert place.read_bytes() == another
    # One that is newer than the output is of another input.
    target.touch()
    os.utime(target, (0.9e9, 0.9e9))
    with pytest.raises(OutputError):
        carry(["mesh.mtl"], source, target, force=True)
    os.utime(target, (1.1e9, 1.1e9))
    carry(["mesh.mtl"], source, target, force=True)
    assert place.read_bytes() == source_of_it.read_bytes()


def test_references_that_leave_the_folder(tmp_path):
    for folder in ("a/in", "a/out", "b/out"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "a/shared.mtl").write_bytes(b"newmtl x\n")
    source = tmp_path / "a/in/mesh.obj"
    # From a sibling folder the name leads to the same file.
    assert carry(["../shared.mtl"], source, tmp_path / "a/out/mesh.obj") == ()
    (note,) = carry(["../shared.mtl"], source, tmp_path / "b/out/mesh.obj")
    assert note.startswith("warning: ../shared.mtl")
    assert tree(tmp_path) == {"a/shared.mtl": b"newmtl x\n"}
    # Where the run searched the folder above, it belongs to the meshes.
    notes = carry(["../shared.mtl"], source, tmp_path / "b/out/mesh.obj", depth=1)
    assert notes == ("copied ../shared.mtl",) and (tmp_path / "b/shared.mtl").is_file()


@pytest.mark.parametrize(
    ("name", "word"),
    [
        *((name, "absolute") for name in ("/etc/hostname", "C:\\textures\\a.png", "C:a.png")),
        ("\\\\server\\share\\a.png", "absolute"),
        *(
            (name, "^warning:")
            for name in ("", "   ", "a\0b", ".", "..", "tex", "no/such/file.mtl")
        ),
    ],
)
def test_absolute_references_and_names_without_a_file_stay(scene, name, word):
    source, target = scene
    (note,) = carry([name], source, target)
    assert re.search(word, note)
    assert not target.parent.exists()


@posix
def test_links_that_lead_round_or_out(scene, tmp_path):
    source, target = scene
    (source.parent / "loop.mtl").symlink_to("loop.mtl")
    (note,) = carry(["loop.mtl"], source, target)
    assert "missing" in note
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    target.parent.mkdir()
    (target.parent / "tex").symlink_to(elsewhere)
    notes = carry(["tex/bump.png"], source, target)
    assert "leads out of the output folder" in notes[0]
    assert list(elsewhere.iterdir()) == []
    (target.parent / "mesh.mtl").symlink_to("nowhere")
    with pytest.raises(OutputError):
        carry(["mesh.mtl"], source, target)


@posix
@pytest.mark.parametrize("kind", ["pipe", "device", "outside", "folder outside"])
def test_materials_that_are_no_files_of_the_folder(scene, tmp_path, kind):
    source, target = scene
    secret, folder = tmp_path / "secret", source.parent / "t"
    secret.mkdir()
    (secret / "m.mtl").write_bytes(b"map_Kd key.png\n")
    if kind == "folder outside":
        folder.symlink_to(secret)
    else:
        folder.mkdir()
        if kind == "pipe":
            os.mkfifo(folder / "m.mtl")
        else:
            (folder / "m.mtl").symlink_to("/dev/zero" if kind == "device" else secret / "m.mtl")
    # Not even the names that stand in it are given.
    (note,) = carry(["t/m.mtl"], source, target)
    reason = "leads out of" if "outside" in kind else "is not a regular file"
    assert f"t/m.mtl {reason}" in note and not target.parent.exists()


@pytest.mark.parametrize(
    ("line", "name"),
    [
        (b"map_Kd a.png", "a.png"),
        *((b"map_Ks -o 0.5 %sa.png" % more, "a.png") for more in (b"", b"1 ", b"1 -2e-1 ")),
        (b"  map_kd   a.png  ", "a.png"), (b"map_Kd\ta.png", "a.png"),
        (b"map_Kd my texture.png", "my texture.png"),
        (b'map_Kd "quoted name.png"', "quoted name.png"), (b"map_Ks -t 1 2 3 4.png", "4.png"),
        (b"map_d -mm 0 1 -blendu off -blendv on -cc on a.png", "a.png"),
        (b"bump -bm 1.5 -imfchan r a.png", "a.png"), (b"refl -type sphere a.png", "a.png"),
        (b"map_Kd -texres 256 -boost 2 -clamp on -s 2 2 a b.png", "a b.png"),
        (b"map_Kd -strange.png", "-strange.png"), (b"map_Kd caf\xe9.png", "caf\udce9.png"),
        *((line, "") for line in (b"map_Kd", b"map_Kd -clamp on", b"Kd 1 0 0", b"")),
        *((line, "") for line in (b"newmtl map_Kd", b"# map_Kd a.png")),
    ],
)  # fmt: skip
def test_texture_lines(line, name, tmp_path):
    (tmp_path / "a.mtl").write_bytes(line)
    assert sidecars._textures(tmp_path / "a.mtl") == [name] * bool(name)


def test_files_of_any_size_are_not_copied(scene, monkeypatch):
    source, target = scene
    with (source.parent / "tex/bump.png").open("wb") as file:
        file.truncate(1 << 42)
    notes = carry(["mesh.mtl"], source, target)
    assert "warning: tex/bump.png is not copied: more than 4,294,967,296 bytes" in " ".join(notes)
    assert not (target.parent / "tex/bump.png").exists()
    assert (target.parent / "tex/back.png").exists()
    monkeypatch.setattr(sidecars, "MAX_BYTES", 150)
    (source.parent / "tex/bump.png").write_bytes(bytes(100))
    notes = carry(["tex/bump.png", "tex/back.png"], source, target.parent / "more/mesh.obj")
    assert notes[0] == "copied tex/bump.png" and "is not copied" in notes[1]
