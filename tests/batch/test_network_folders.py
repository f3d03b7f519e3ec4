"""Folders that must be polled, by lines as Linux has them."""

import ctypes
import sys
from types import SimpleNamespace

import pytest

from msal_cli.batch import network_folders
from msal_cli.batch.network_folders import find_type, is_on_network

MOUNTS = r"""
22 1 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw
30 22 0:5 / /mnt/nas rw,relatime shared:2 master:1 - nfs4 nas:/scans rw,vers=4.2
31 30 0:6 / /mnt/nas/local rw - ext4 /dev/sdb1 rw
32 22 0:7 / /mnt/my\040share rw - cifs //nas/scans rw
33 22 0:8 / /mnt/cloud rw - fuse.rclone remote: rw
34 22 0:9 / /mnt/nasty rw - xfs /dev/sdc1 rw
35 22 0:9 / /mnt/twice rw - nfs a:/b rw
36 22 0:9 / /mnt/twice rw - tmpfs tmpfs rw
bad line
""".splitlines()


@pytest.mark.parametrize(
    ("path", "file_system", "is_remote"),
    [
        ("/home/me", "ext4", False),
        ("/mnt/nas", "nfs4", True),
        ("/mnt/nas/a/b", "nfs4", True),
        ("/mnt/nas/local/a", "ext4", False),
        ("/mnt/nasty", "xfs", False),
        ("/mnt/my share/a", "cifs", True),
        ("/mnt/cloud/a", "fuse.rclone", True),
        ("/mnt/twice", "tmpfs", False),
    ],
)
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such lines")
def test_the_mount_that_a_folder_is_on(path, file_system, is_remote, tmp_path, monkeypatch):
    assert find_type(path, MOUNTS) == file_system
    lines = tmp_path / "mountinfo"
    lines.write_text("\n".join(MOUNTS))
    monkeypatch.setattr(network_folders, "_MOUNTS", str(lines))
    monkeypatch.setattr(network_folders.os.path, "realpath", lambda one: one)
    assert is_on_network(path) is is_remote


def test_where_the_system_does_not_say(tmp_path, monkeypatch):
    monkeypatch.setattr(network_folders, "_MOUNTS", str(tmp_path / "none"))
    assert is_on_network(str(tmp_path)) is False


@pytest.mark.parametrize(
    ("path", "drive_type", "is_remote"),
    [("C:\\scans", 3, False), ("Z:\\scans", 4, True), ("\\\\nas\\share\\scans", 0, True)],
)
def test_drives_of_windows(path, drive_type, is_remote, monkeypatch):
    import ntpath

    kernel = SimpleNamespace(GetDriveTypeW=lambda root: drive_type)
    monkeypatch.setattr(ctypes, "windll", SimpleNamespace(kernel32=kernel), raising=False)
    monkeypatch.setattr(network_folders.sys, "platform", "win32")
    fake = SimpleNamespace(abspath=ntpath.normpath, splitdrive=ntpath.splitdrive)
    monkeypatch.setattr(network_folders, "os", SimpleNamespace(path=fake))
    assert is_on_network(path) is is_remote
