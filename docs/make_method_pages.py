"""Make the pages of ``methods/`` from what the methods say of themselves.

    python docs/make_method_pages.py

Every method found by name gets a page, from its docstring and its table of parameters, and a row in
the index.  The pages depend on nothing else; a test fails where this was forgotten.
"""

from __future__ import annotations

import collections
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

from msal_cli import methods
from msal_cli.cli.methods import SHORTCUTS
from msal_cli.methods import Method, ParameterSpec

FOLDER = Path(__file__).resolve().parent / "methods"
MADE = "<!-- made by docs/make_method_pages.py: change the method and run it again -->\n"

INDEX = """# Methods

`msal denoise scan.ply -o smooth.ply --method NAME` runs the method of that name, `--set NAME=VALUE`
sets any of its parameters, and `msal methods NAME` prints what its page says, and all ranges.
[algorithm.md](../algorithm.md#which-setting) says which setting suits which surface.

In all of them a vertex without neighbours, faces or a normal stays, and faces without area do not
count. To filters of normals a vertex or an edge with more than 64 faces does not make its faces
neighbours. The time grows in proportion to the size of the mesh. TVCG, TOG and TIP are
Transactions: on Visualization and Computer Graphics, on Graphics, on Image Processing.

"""


def inline(text: str, link_from: str = "") -> str:
    """A paragraph of a docstring as Markdown, in one line.

    Code stands between pairs of backticks; the name of another method than ``link_from`` leads to
    its page, and so does the name of a page, such as ``docs/noise.md``.
    """
    folder = "../" if link_from else ""
    parts = re.split(r"``(.+?)``", " ".join(text.split()))
    for at, part in enumerate(parts):
        if at % 2 == 0:
            parts[at] = re.sub(r"([*\\`|]|<(?=[A-Za-z/!]))", r"\\\1", part)
            parts[at] = re.sub(r"\bdocs/(\w+\.md)", rf"[\1]({folder}\1)", parts[at])
        elif link_from and part != link_from and part in methods.names():
            parts[at] = f"[`{part}`]({part}.md)"
        else:
            parts[at] = f"`{part}`"
    return "".join(parts)


def prose(description: str, name: str) -> Iterator[str]:
    """The blocks of a docstring as Markdown: formulas where they are indented, lists, prose."""
    for block in filter(None, re.split(r"\n\s*\n", description)):
        items = re.split(r"^(-|\d+\.) +", block, flags=re.MULTILINE)
        if all(line.startswith("    ") for line in block.splitlines()):
            yield f"```\n{textwrap.dedent(block)}\n```\n"
        elif not items[0] and len(items) > 1:
            pairs = zip(items[1::2], items[2::2], strict=True)
            yield "".join(f"{mark} {inline(item, name)}\n" for mark, item in pairs)
        else:
            yield f"{inline(block, name)}\n"


SHARED = 2
"""From how many methods with the same parameter on the index explains it for all of them."""

Meaning = tuple[str, str, str, str]


def meaning(spec: ParameterSpec) -> Meaning:
    """All that is said of a parameter but its default."""
    return spec.name, spec.range_text, spec.help, spec.more


def shared_specs(all_methods: list[Method]) -> dict[Meaning, list[str]]:
    """The methods by the parameters that the index explains: those of several methods."""
    users: dict[Meaning, list[str]] = {}
    for method in all_methods:
        for spec in method.parameters:
            users.setdefault(meaning(spec), []).append(method.name)
    return {key: names for key, names in users.items() if len(names) >= SHARED}


def common_defaults(all_methods: list[Method]) -> dict[Meaning, str]:
    """The defaults of shared parameters that all their methods have."""
    defaults: dict[Meaning, set[str]] = {}
    for method in all_methods:
        for spec in method.parameters:
            defaults.setdefault(meaning(spec), set()).add(f"{spec.default}")
    return {key: words.pop() for key, words in defaults.items() if len(words) == 1}


def shared_items(all_methods: list[Method]) -> Iterator[str]:
    """The parameters that the index explains; one of several meanings with its methods."""
    shared = shared_specs(all_methods)
    defaults = common_defaults(all_methods)
    specs = {meaning(spec): spec for method in all_methods for spec in method.parameters}
    counts = collections.Counter(name for name, *_ in shared)
    for key, names in sorted(shared.items(), key=lambda pair: pair[0][0]):
        of = f" of {', '.join(names)}" if counts[key[0]] > 1 else ""
        yield item(specs[key], defaults.get(key, ""), of)


def item(spec: ParameterSpec, default: str = "", of: str = "") -> str:
    """A parameter in a list: names, default, allowed words, meaning and direction."""
    names = [
        spec.name,
        SHORTCUTS.get(spec.name, ""),
        spec.symbol if spec.symbol != spec.name else "",
    ]
    head = ", ".join(f"`{name}`" for name in names if name)
    if default:
        head += f" = `{default}`"
    unit = f" ({spec.unit})" if spec.unit else ""
    more = f" More is {inline(spec.more)}." if spec.more else ""
    text = inline(spec.help) + unit
    words = ", ".join(f"`{word}`" for word in spec.choices or ())
    allowed = f" ({words})" if words else ""
    return f"- {head}{of}{allowed}: {text}{'' if text.endswith('.') else '.'}{more}\n"


def parameters(method: Method, all_methods: list[Method]) -> Iterator[str]:
    """The parameters of a method: a list of its own ones, a sentence on the shared ones."""
    shared, defaults = shared_specs(all_methods), common_defaults(all_methods)
    own = [spec for spec in method.parameters if meaning(spec) not in shared]
    others = [spec for spec in method.parameters if meaning(spec) in shared]
    if own:
        yield "".join(item(spec, f"{spec.default}") for spec in own)
    if others:
        words = ", ".join(
            f"`{spec.name}`" + ("" if meaning(spec) in defaults else f" (`{spec.default}`)")
            for spec in others
        )
        yield f"[Shared](README.md#shared-parameters): {words}.\n"


def page(method: Method, all_methods: list[Method]) -> str:
    """All about one method."""
    before, _, rest = method.description.partition("Source:")
    _, _, body = before.partition("\n")
    _, _, after = rest.partition("\n\n")
    blocks = [*prose(body.strip("\n"), method.name), *prose(after.strip("\n"), method.name)]
    return "\n".join(
        [
            MADE,
            f"# `{method.name}`\n",
            f"**{inline(method.summary)}**\n",
            *blocks,
            "## Parameters\n",
            *parameters(method, all_methods),
            f"Source: {inline(method.source)}\n",
        ]
    )


def index(all_methods: list[Method]) -> str:
    """The table of all methods, and which of them take a schedule."""
    rows = "".join(
        f"| [`{method.name}`]({method.name}.md) | {inline(method.summary)} |\n"
        for method in all_methods
    )
    scheduled = [
        f"[`{method.name}`]({method.name}.md)"
        for method in all_methods
        if any("plain" in spec.choices for spec in method.parameters)
    ]
    return (
        MADE
        + "\n"
        + INDEX
        + "| method | what it does |\n|---|---|\n"
        + rows
        + "\n`--schedule plain|constant|multiscale|robust|wiener` composes the iterations of "
        f"`msal` with another operator: {', '.join(scheduled)} take it. `msal` itself takes the "
        "last three.\n\n"
        "## Shared parameters\n\n"
        "Pages have the defaults that differ. Further names are options, and symbols that `--set` "
        "takes.\n\n" + "".join(shared_items(all_methods))
    )


def pages() -> dict[str, str]:
    """Every page by its file name."""
    found = [methods.find(name) for name in methods.names()]
    made = {f"{method.name}.md": page(method, found) for method in found}
    return {"README.md": index(found)} | made


def committed() -> dict[str, str]:
    """The pages that this script once made, by file name."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.md")}
    return {name: text for name, text in texts.items() if text.startswith(MADE)}


def main() -> None:
    """Write every page, and remove those of methods that are no more."""
    FOLDER.mkdir(exist_ok=True)
    for name in committed().keys() - pages().keys():
        (FOLDER / name).unlink()
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
