"""Make api.md, the reference of the Python API, from its signatures and docstrings.

python docs/make_api_page.py
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import textwrap
from pathlib import Path
from typing import Any, get_args, get_type_hints

sys.path.insert(0, str(Path(__file__).resolve().parent))

from make_command_page import shorten
from make_method_pages import inline, prose

import msal_cli as msal

PAGE = Path(__file__).resolve().parent / "api.md"

HEAD = """<!-- made by docs/make_api_page.py: change the docstrings and run it again -->

# All functions, records and errors

Everything is in `msal_cli`, as in `import msal_cli as msal`. [python.md](python.md) explains it
with examples. `help(msal.denoise)` says more of each name, with errors and examples.
Each argument is explained under the first function that has it.

"""
RECORDS = """## Records

Functions return records; `null` of reports is `None` in Python. [report.md](report.md) explains the
fields of LINKS. And:

| record | what it is | fields |
|---|---|---|
"""
SCHEMAS = {msal.ComparisonRecord: "[compare.schema.json](compare.schema.json)"}
"""Where the fields of a record are explained one by one."""

MIN_SHARED = 4
"""Arguments of a function before from which on a signature names them in a comment."""

_SECTION = re.compile(r"^(\w+)\n-{3,}\n", re.MULTILINE)


def signature(function: Any, listed: dict[str, str]) -> str:
    """A function with its arguments, one a line where they are many, keywords without types.

    Many arguments that are alike in a function before, by their text in ``listed``, stand in a
    comment; the others are added there.
    """
    arguments = list(inspect.signature(function).parameters.values())
    arguments_by_name = {one.name: one for one in arguments}
    texts = {one.name: argument(one) for one in arguments}
    keywords = [one.name for one in arguments if one.kind is one.KEYWORD_ONLY]
    as_before = [name for name in keywords if texts[name] in listed]
    if len(as_before) < MIN_SHARED:
        as_before = []
    lines = []
    for name, text in texts.items():
        if keywords and name == keywords[0]:
            lines.append("*,")
        if name not in as_before:
            short = f"{name}={arguments_by_name[name].default!r}" if name in keywords else text
            lines.append(f"{short},")
    if as_before:
        names = f"and of {listed[texts[as_before[-1]]]}: {', '.join(as_before)}"
        lines[-1:-1] = [f"# {line}" for line in textwrap.wrap(names, 78)]
    listed |= dict.fromkeys(texts.values(), function.__name__)
    line = f"{function.__name__}({' '.join(lines).removesuffix(',')})"
    if len(line) > 80:
        line = f"{function.__name__}(\n    " + "\n    ".join(lines) + "\n)"
    return f"```python\n{line}\n```\n"


def argument(parameter: inspect.Parameter) -> str:
    """An argument with its type and its default."""
    star = {parameter.VAR_KEYWORD: "**", parameter.VAR_POSITIONAL: "*"}.get(parameter.kind, "")
    text = f"{star}{parameter.name}: {parameter.annotation}"
    return text if parameter.default is parameter.empty else f"{text} = {parameter.default!r}"


def describe(function: Any, seen: set[tuple[str, str]]) -> str:
    """The first paragraph of a docstring, and the arguments that are not among those ``seen``."""
    first, *rest = _SECTION.split(inspect.getdoc(function) or "")
    parts = [*prose(first.strip("\n"), "")][:1]
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        if title == "Parameters":
            found = re.findall(r"^(\S.*?) : ((?:.*\n?)(?:^ .*\n?)*)", body.strip("\n") + "\n", re.M)
            new = [entry for entry in found if entry not in seen]
            seen.update(new)
            parts.append(
                "".join(f"- {names(words)}: {inline(shorten(text))}\n" for words, text in new)
            )
        elif title == "Returns":
            parts.append(f"Returns: {inline(body)}\n")
    return "\n".join(parts) + "\n"


def names(text: str) -> str:
    """Names between commas, or ``method to fail_on``, as code."""
    return re.sub(r"\w+", lambda word: word[0] if word[0] == "to" else f"`{word[0]}`", text)


def record(cls: type) -> str:
    """A record: its first sentence, its fields and its properties."""
    names = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for name, value in vars(cls).items():
        if isinstance(value, property) and not name.startswith("_"):
            names.append(name)
    fields = SCHEMAS.get(cls) or ", ".join(f"`{name}`" for name in names)
    first = inline((inspect.getdoc(cls) or "").split("\n\n")[0])
    return f"| `{cls.__name__}` | {first} | {fields} |\n"


def records_of_reports() -> dict[type, str]:
    """The anchors of report.md by the record that has its fields there."""
    anchors: dict[type, str] = {msal.MeshRecord: "the-record"}
    for name, hint in get_type_hints(msal.MeshRecord).items():
        for cls in (hint, *get_args(hint)):
            if dataclasses.is_dataclass(cls):
                anchors[cls] = name
    return anchors


def page() -> str:
    """The whole page."""
    found = [getattr(msal, name) for name in msal.__all__ if not name.startswith("_")]
    functions = [one for one in found if inspect.isfunction(one)]
    errors = [one for one in found if inspect.isclass(one) and issubclass(one, Exception)]
    records = [one for one in found if inspect.isclass(one) and one not in errors]
    text = HEAD + "## Functions\n\n"
    # As python.md does: what most people need comes first.
    seen: set[tuple[str, str]] = set()
    listed: dict[str, str] = {}
    for function in sorted(functions, key=lambda found: not found.__name__.startswith("denoise")):
        text += f"### `{function.__name__}`\n\n{signature(function, listed)}\n"
        text += f"{describe(function, seen)}\n"
    anchors = records_of_reports()
    links = [f"[`{cls.__name__}`](report.md#{anchors[cls]})" for cls in records if cls in anchors]
    text += RECORDS.replace("LINKS", ", ".join(links))
    text += "".join(record(cls) for cls in records if cls not in anchors)
    text += "\n## Errors\n\n| class | is a | when |\n|---|---|---|\n"
    for one in sorted(errors, key=lambda one: (len(one.__mro__), one.__name__)):
        meaning = inline((inspect.getdoc(one) or "").split("\n\n")[0])
        text += f"| `{one.__name__}` | `{one.__base__.__name__}` | {meaning} |\n"
    return re.sub(r"\n{3,}", "\n\n", text)


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
