"""The table of who may import whom (docs/architecture.md), held against the syntax trees."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import msal_cli

PACKAGE = Path(msal_cli.__file__).parent

# What every layer may import.
EVERYWHERE = {"cores", "control_groups"}

MAY_IMPORT = {
    "errors": set(),
    "extras": set(),
    "units": {"errors"},
    "colours": set(),
    "cores": set(),
    "control_groups": set(),
    "core": {"errors"},
    "mesh": {"core", "errors"},
    "methods": {"mesh", "noise_estimate", "core", "errors"},
    "metrics": {"mesh", "core", "errors"},
    "noise": {"mesh", "core", "errors"},
    "noise_estimate": {"mesh", "core", "errors"},
    "noise_model": {"mesh", "noise", "noise_estimate", "core", "errors"},
    "outliers": {"noise_estimate", "mesh", "core", "errors"},
    "files": {"extras", "mesh", "core", "errors"},
    "records": {"errors"},
    "constraints": {"core", "files", "mesh", "units", "errors"},
    "corruption": {"files", "mesh", "noise", "errors"},
    "scanning": {"files", "mesh", "simulation", "errors"},
    "simulation": {"extras", "mesh", "metrics", "noise", "core", "errors"},
    "baseline": {"records", "errors"},
    "comparison": {"colours", "files", "metrics", "mesh", "records", "errors"},
    "gates": {"records", "units", "errors"},
    "fields": {"colours", "files", "metrics", "noise_estimate", "mesh", "records", "errors"},
    "inspection": {"files", "metrics", "noise_estimate", "mesh", "records", "errors"},
    "selection": {"methods", "metrics", "noise_estimate", "noise_model", "mesh", "core", "errors"},
    "automatic": {"selection", "methods", "noise_estimate", "mesh", "records"},
    "memory": set(),
    "left_alone": {"constraints", "noise_estimate", "mesh", "tasks"},
    "changes": {"comparison", "inspection", "metrics", "noise_estimate", "mesh", "records"},
    "output": {"files", "tasks", "errors"},
    "tasks": {"files", "memory", "methods", "records", "selection", "errors"},
    "advice": {"methods", "noise_estimate", "records"},
    "preparation": {
        "automatic",
        "left_alone",
        "methods",
        "metrics",
        "noise_estimate",
        "outliers",
        "tasks",
        "mesh",
        "records",
    },
    "pipeline": {
        "advice",
        "changes",
        "constraints",
        "fields",
        "files",
        "memory",
        "methods",
        "noise_estimate",
        "output",
        "preparation",
        "tasks",
        "mesh",
        "records",
        "errors",
    },
    # Of files only what tells URLs from paths, objects in stores, and files from pipes.
    "batch": {
        "extras",
        "pipeline",
        "memory",
        "records",
        "errors",
        "files.regular",
        "files.remote",
        "files.urls",
    },
    "report": {"records", "errors"},
    "render": {"core", "colours", "errors"},
    # Of report only how names are shown.
    "page": {"colours", "mesh", "report.names", "errors"},
    "parameter_grid": {"comparison", "methods", "metrics", "mesh", "pictures", "render", "errors"},
    "pictures": {"comparison", "metrics", "mesh", "records", "render", "errors"},
    "gallery": {
        "colours",
        "comparison",
        "files",
        "mesh",
        "page",
        "pictures",
        "records",
        "render",
        "report.illustrations",
        "report.worst",
        "errors",
    },
    "pages": {"page", "pictures", "mesh", "records", "render", "errors"},
    "cli": {
        "baseline",
        "constraints",
        "batch",
        "colours",
        "comparison",
        "corruption",
        "fields",
        "errors",
        "files",
        "gallery",
        "gates",
        "inspection",
        "mesh",
        "methods",
        "metrics",
        "noise",
        "pages",
        "parameter_grid",
        "pictures",
        "pipeline",
        "records",
        "render",
        "output",
        "report",
        "scanning",
        "selection",
        "simulation",
        "units",
    },
    "__main__": {"cli"},
    "__init__": set(),
}

ONLY_IN = {
    "kernel_build": {"core.library"},
    "llvmlite": set(),
    "numba": set(),
    "trimesh": {"files"},
    "meshio": {"files"},
    "click": {"cli"},
    "tqdm": {"cli"},
    "multiprocessing": {"batch"},
    "fsspec": {"files.remote"},
    "s3fs": set(),
    "PIL": {"render"},
    "fcpw": {"metrics.surface_distance", "simulation.surface"},
    "scipy": {"simulation"},
    "skimage": {"simulation"},
}


def modules():
    return sorted(PACKAGE.rglob("*.py"))


def imports(path):
    """Names of the modules that a file imports, with the depth at which it does."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                is_module = node.module == "msal_cli" or is_file_of_ours(inner)
                yield inner if is_module else node.module


def is_file_of_ours(name):
    return (PACKAGE.parent / name.replace(".", "/")).with_suffix(".py").is_file()


def layer_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_keep_to_the_table(path):
    layer = layer_of(path)
    for name in imports(path):
        parts = name.split(".")
        if parts[0] == "msal_cli" and len(parts) > 1 and parts[1] != "__version__":
            allowed = MAY_IMPORT[layer] | EVERYWHERE | {layer}
            assert allowed & {parts[1], ".".join(parts[1:3])}, f"{layer} imports {name}"
        if parts[0] in ONLY_IN:
            module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
            assert {layer, module} & ONLY_IN[parts[0]], f"{module} imports {name}"


def test_methods_do_not_import_one_another():
    for path in (PACKAGE / "methods").glob("*.py"):
        for name in imports(path):
            if name.startswith("msal_cli.methods.") and path.name != "__init__.py":
                assert name.split(".")[2].startswith("_"), f"{path.name} imports {name}"


@pytest.mark.parametrize(
    "module", ["msal_cli.files", "msal_cli.methods", "msal_cli.mesh", "msal_cli.pipeline"]
)
def test_heavy_libraries_wait_until_they_are_needed(module):
    code = (
        f"import {module}, sys; "
        "print([n for n in ('numba', 'trimesh', 'meshio', 'scipy') if n in sys.modules])"
    )
    seen = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert seen.strip() == "[]"
