"""Other tools, each in a script of its own, at its best.

Every script is called as ``python SCRIPT.py INPUT OUTPUT``, imports as little as it can, and does
what ``msal denoise INPUT -o OUTPUT`` does at its defaults: read the file, smooth it in 4 steps,
write the same kind of file.  ``folder.py`` runs one of them over a folder in one process.

None of these tools is needed by msal, and nothing of msal is needed by the scripts: they run under
any Python that has the tools.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

_HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Peer:
    """One way to smooth a file with one tool.

    script : name of the file here, without suffix.
    title : how tables name it.
    packages : what must be installed for it, the tool itself first.
    is_binary_only : writes binary PLY where an ascii PLY was read.
    is_by_hand : no tool, but what one would write without one; the best peer is looked for among
        the tools as long as there is any.
    """

    script: str
    title: str
    packages: tuple[str, ...]
    is_binary_only: bool = False
    is_by_hand: bool = False

    def command(self, python: str, source: Path, target: Path) -> list[str]:
        """One file in a process of its own."""
        return [python, str(_HERE / f"{self.script}.py"), str(source), str(target)]

    def folder_command(self, python: str, source: Path, target: Path) -> list[str]:
        """All files of a folder in one process."""
        return [python, str(_HERE / "folder.py"), self.script, str(source), str(target)]


PEERS = (
    Peer("meshlib_relax", "MeshLib relax", ("meshlib",), is_binary_only=True),
    Peer("vtk_windowed_sinc", "VTK windowed sinc", ("vtk",)),
    Peer("vtk_smooth", "VTK Laplacian", ("vtk",)),
    Peer("pyvista_taubin", "PyVista Taubin", ("pyvista",)),
    Peer("pymeshlab_laplacian", "PyMeshLab Laplacian", ("pymeshlab",)),
    Peer("open3d_simple", "Open3D simple", ("open3d",)),
    Peer("trimesh_laplacian", "trimesh Laplacian", ("trimesh", "scipy")),
    Peer("meshio_mean", "meshio and numpy", ("meshio", "numpy"), is_by_hand=True),
)

_VERSIONS = """
import importlib.metadata, json, sys
found = {}
for name in sys.argv[1:]:
    try:
        found[name] = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        pass
print(json.dumps(found))
"""


def versions(python: str) -> dict[str, str]:
    """Versions of the peers' packages that a Python has."""
    names = sorted({name for peer in PEERS for name in peer.packages})
    ran = subprocess.run(
        [python, "-c", _VERSIONS, *names], capture_output=True, text=True, check=True
    )
    return dict(json.loads(ran.stdout))


def installed(python: str, only: list[str] | None = None) -> tuple[list[Peer], str]:
    """The peers that can run, and a line on their versions; says which cannot, and why.

    Parameters
    ----------
    python : path of the Python that is to run them.
    only : scripts to take; all if None.
    """
    known = versions(python)
    taken = []
    for peer in PEERS:
        if only is not None and peer.script not in only:
            continue
        missing = [name for name in peer.packages if name not in known]
        if missing:
            print(f"skipped: {peer.title}: {python} has no {', '.join(missing)}", file=sys.stderr)
        else:
            taken.append(peer)
    tools = sorted({peer.packages[0] for peer in taken})
    return taken, ", ".join(f"{name} {known[name]}" for name in tools) or "no peer installed"


def default_python() -> str:
    """The Python that has the peers: ``MSAL_PEERS_PYTHON``, or this one."""
    return os.environ.get("MSAL_PEERS_PYTHON", sys.executable)
