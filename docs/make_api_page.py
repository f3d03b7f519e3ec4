"""Make api.md, the reference of the Python API, from its signatures and docstrings.

python docs/make_api_page.py
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from make_method_pages import inline, prose

import msal_cli as msal

PAGE = Path(__file__).resolve().parent / "api.md"

HEAD = """<!-- made by docs/make_api_page.py: change the docstrings and run it again -->

# All functions, records and errors

Everything is in `msal_cli`, as in `import msal_cli as msal`. [python.md](python.md) explains it
with examples. `help(msal.denoise)` shows the same text as this page.

"""
RECORDS = """## Records

Functions return records, and the reports of the command have the same fields:
[report.md](report.md). `null` is `None` in Python.

"""
_SECTION = re.compile(r"^(\w+)\n-{3,}\n", re.MULTILINE)


def signature(function: Any) -> str:
    """A function with its arguments, one a line where they are many."""
    arguments = []
    found = list(inspect.signature(function).parameters.values())
    for at, one in enumerate(found):
        if one.kind is one.KEYWORD_ONLY and (at == 0 or found[at - 1].kind is not one.kind):
            arguments.append("*")
        star = {one.VAR_KEYWORD: "**", one.VAR_POSITIONAL: "*"}.get(one.kind, "")
        text = f"{star}{one.name}: {one.annotation}"
        arguments.append(text if one.default is one.empty else f"{text} = {one.default!r}")
    line = f"{function.__name__}({', '.join(arguments)})"
    if len(line) > 80:
        line = f"{function.__name__}(\n    " + ",\n    ".join(arguments) + ",\n)"
    return f"```python\n{line}\n```\n"


def sections(documentation: str) -> str:
    """A docstring as Markdown: prose, tables of arguments and of errors, code."""
    first, *rest = _SECTION.split(documentation)
    parts = [*prose(first.strip("\n"), "")]
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        parts.append(f"**{title}**\n")
        body = body.strip("\n")
        if title == "Examples":
            body = re.sub(r"^>>> |  # doctest:.*", "", body, flags=re.MULTILINE)
            # As ruff formats the code of pages.
            body = re.sub(r"^(import .*\n)(?!import|\n)", r"\1\n", body, flags=re.MULTILINE)
            parts.append(f"```python\n{body}\n```\n")
        elif title in ("Parameters", "Attributes"):
            parts.append(table(re.findall(r"^(\S.*?) : ((?:.*\n?)(?:^ .*\n?)*)", body, re.M)))
        elif title == "Raises":
            parts.append(table(re.findall(r"^(\S.*)\n((?:^ .*\n?)+)", body, re.M), "error"))
        else:
            parts.extend(prose(body, ""))
    return "\n".join(parts) + "\n"


def table(entries: list[tuple[str, str]], head: str = "name") -> str:
    """Names and what they mean."""
    rows = "".join(f"| {names(one)} | {inline(text)} |\n" for one, text in entries)
    return f"| {head} | meaning |\n|---|---|\n{rows}"


def names(text: str) -> str:
    """Names between commas, or ``method to fail_on``, as code."""
    return re.sub(r"\w+", lambda word: word[0] if word[0] == "to" else f"`{word[0]}`", text)


def record(cls: type) -> str:
    """A record: its docstring, its fields and its properties."""
    rows = []
    for one in dataclasses.fields(cls):  # type: ignore[arg-type]
        text = str(one.metadata.get("description", ""))
        rows.append(f"| `{one.name}` | {code(one.type)} | {inline(text)} |\n")
    for name, value in vars(cls).items():
        if isinstance(value, property) and not name.startswith("_"):
            kind = inspect.signature(value.fget).return_annotation
            rows.append(f"| `{name}` | {code(kind)} | {inline(inspect.getdoc(value) or '')} |\n")
    text = sections(inspect.getdoc(cls) or "")
    return (
        f"### `{cls.__name__}`\n\n{text}\n| field | type | meaning |\n|---|---|---|\n"
        + "".join(rows)
        + "\n"
    )


def code(annotation: Any) -> str:
    """A type that may stand in a table."""
    text = annotation if isinstance(annotation, str) else annotation.__name__
    return "`" + text.replace("|", "\\|") + "`"


def page() -> str:
    """The whole page."""
    found = [getattr(msal, name) for name in msal.__all__ if not name.startswith("_")]
    functions = [one for one in found if inspect.isfunction(one)]
    errors = [one for one in found if inspect.isclass(one) and issubclass(one, Exception)]
    records = [one for one in found if inspect.isclass(one) and one not in errors]
    text = HEAD + "## Functions\n\n"
    # As python.md does: what most people need comes first.
    for one in sorted(functions, key=lambda one: not one.__name__.startswith("denoise")):
        text += f"### `{one.__name__}`\n\n{signature(one)}\n{sections(inspect.getdoc(one) or '')}\n"
    text += RECORDS + "".join(map(record, records))
    text += "## Errors\n\n| class | is a | when |\n|---|---|---|\n"
    for one in sorted(errors, key=lambda one: (len(one.__mro__), one.__name__)):
        meaning = inline((inspect.getdoc(one) or "").split("\n\n")[0])
        text += f"| `{one.__name__}` | `{one.__base__.__name__}` | {meaning} |\n"
    return re.sub(r"\n{3,}", "\n\n", text)


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
