"""Who may import whom (docs/architecture.md), by the syntax trees; what extras need."""

import ast
import functools
import graphlib
import importlib
import re
import tomllib
from pathlib import Path

import msal_cli
from msal_cli.errors import EXTRAS, install_hint

PACKAGE = Path(msal_cli.__file__).parent

PAGE = (PACKAGE.parent / "docs/architecture.md").read_text("utf-8")


def read_table() -> list[tuple[list[str], list[str]]]:
    """The layers of each row of the page's first table, and what they may import."""
    lines = PAGE.partition("## The way")[0].splitlines()
    rows = [line.split("|") for line in lines if line.startswith("| `")]
    return [(re.findall(r"`(\w+)`", row[1]), re.findall(r"`(\w+)`", row[3])) for row in rows]


# The first row is of what every layer may import.
(EVERYWHERE, _), *LAYERS = read_table()
MAY_IMPORT = {layer: set(allowed) for layers, allowed in LAYERS for layer in layers}
MAY_IMPORT |= {layer: set() for layer in EVERYWHERE} | {"__main__": {"cli"}, "__init__": {"api"}}

ONLY_IN = {
    "llvmlite": set(),
    "numba": set(),
    "trimesh": {"codecs"},
    "meshio": {"codecs"},
    "click": {"cli"},
    "tqdm": {"cli"},
    "multiprocessing": {"batch"},
    "fsspec": {"storage.objects"},
    "s3fs": set(),
    "PIL": {"view"},
    "scipy": set(),
    "skimage": set(),
}


def modules():
    return sorted(PACKAGE.rglob("*.py"))


@functools.cache
def imports(path):
    """Names of the modules that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                is_module = node.module == "msal_cli" or is_file_of_ours(inner)
                names.add(inner if is_module else node.module)
    return names


@functools.cache
def is_file_of_ours(name):
    path = PACKAGE.parent / name.replace(".", "/")
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def name_of(path):
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )


def test_imports_keep_to_the_table():
    wrong = []
    for path in modules():
        layer = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        module = name_of(path).removeprefix("msal_cli.")
        for name in sorted(imports(path)):
            top, _, inner = name.partition(".")
            if top == "msal_cli" and inner:
                is_allowed = inner.split(".")[0] in MAY_IMPORT[layer] | {*EVERYWHERE, layer}
            else:
                homes = ONLY_IN.get(top, {module})
                is_allowed = any(f"{module}.".startswith(f"{home}.") for home in homes)
            wrong += [] if is_allowed else [f"{module} imports {name}"]
    assert wrong == []


def test_no_modules_import_each_other_in_a_circle():
    """Neither at the top, nor inside functions, nor for types alone."""
    graph = {name_of(path): imports(path) - {name_of(path)} for path in modules()}
    graphlib.TopologicalSorter(graph).prepare()  # its CycleError names the circle


def test_methods_do_not_import_one_another():
    for path in (PACKAGE / "methods").glob("*.py"):
        for name in imports(path):
            if name.startswith("msal_cli.methods.") and path.name != "__init__.py":
                assert name.split(".")[2].startswith("_"), f"{path.name} imports {name}"


def test_every_name_of_the_page_is_one_in_the_code():
    names = set(re.findall(r"`((?:[a-z_]+\.)+\w+)`", PAGE)) - {"string.Template"}
    assert len(names) > 40
    for name in names:
        if name.endswith((".py", ".md")):
            continue
        parts = name.split(".")
        for k in range(len(parts), 0, -1):
            try:
                found = importlib.import_module(".".join(["msal_cli", *parts[:k]]))
            except ModuleNotFoundError:
                continue
            for part in parts[k:]:
                found = getattr(found, part)
            break
        else:
            raise AssertionError(f"{name} of docs/architecture.md does not exist")


# What to install for an optional part


def test_the_packages_of_an_extra_are_named():
    text = (Path(__file__).parent.parent / "pyproject.toml").read_text("utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    for extra, words in EXTRAS.items():
        assert words.split() == [re.split("[<>=]", package)[0] for package in extras[extra]]
    assert install_hint("dask") == "pip install distributed (that is msal-cli[dask])"
