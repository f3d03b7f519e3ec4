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
with examples. `help(msal.denoise)` shows all there is to a name, with errors and examples.
What an argument means is said once: under the first function that has it.

"""
RECORDS = """## Records

Functions return records, and the reports of the command have the same fields:
[report.md](report.md) says what each means, `help(msal.DenoiseResult)` as well. `null` is `None` in
Python.

| record | what it is | fields |
|---|---|---|
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


def describe(function: Any, seen: set[tuple[str, str]]) -> str:
    """The beginning of a docstring, and the arguments that are not among those ``seen``."""
    first, *rest = _SECTION.split(inspect.getdoc(function) or "")
    parts = [*prose(first.strip("\n"), "")]
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        if title == "Parameters":
            found = re.findall(r"^(\S.*?) : ((?:.*\n?)(?:^ .*\n?)*)", body.strip("\n"), re.M)
            new = [entry for entry in found if entry not in seen]
            seen.update(new)
            parts.append(table(new) if new else "")
        elif title == "Returns":
            parts.append(f"Returns: {inline(body)}\n")
    return "\n".join(parts) + "\n"


def table(entries: list[tuple[str, str]]) -> str:
    """Names and what they mean."""
    rows = "".join(f"| {names(words)} | {inline(text)} |\n" for words, text in entries)
    return f"| name | meaning |\n|---|---|\n{rows}"


def names(text: str) -> str:
    """Names between commas, or ``method to fail_on``, as code."""
    return re.sub(r"\w+", lambda word: word[0] if word[0] == "to" else f"`{word[0]}`", text)


def record(cls: type) -> str:
    """A record: its first sentence, its fields and its properties."""
    fields = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for name, value in vars(cls).items():
        if isinstance(value, property) and not name.startswith("_"):
            fields.append(name)
    first = inline((inspect.getdoc(cls) or "").split("\n\n")[0])
    return f"| `{cls.__name__}` | {first} | {', '.join(f'`{name}`' for name in fields)} |\n"


def page() -> str:
    """The whole page."""
    found = [getattr(msal, name) for name in msal.__all__ if not name.startswith("_")]
    functions = [one for one in found if inspect.isfunction(one)]
    errors = [one for one in found if inspect.isclass(one) and issubclass(one, Exception)]
    records = [one for one in found if inspect.isclass(one) and one not in errors]
    text = HEAD + "## Functions\n\n"
    # As python.md does: what most people need comes first.
    seen: set[tuple[str, str]] = set()
    for function in sorted(functions, key=lambda found: not found.__name__.startswith("denoise")):
        text += f"### `{function.__name__}`\n\n{signature(function)}\n{describe(function, seen)}\n"
    text += RECORDS + "".join(map(record, records))
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
