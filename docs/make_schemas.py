"""The JSON Schemas beside the pages, made from the records.

    python docs/make_schemas.py [FOLDER]

A field's description is in its metadata; a field of another record that has none is described as
the field of that name of a ``MeshRecord``.
"""

from __future__ import annotations

import dataclasses
import sys
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from msal_cli.job.records import SCHEMA, ComparisonRecord, InfoRecord, MeshRecord, Run
from msal_cli.report.data import json_bytes
from msal_cli.report.facts import Totals

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NULL_NOTE = (
    "A number that is not finite is null, and so is what could not be determined. Fields may be "
    "added, none is removed or given another meaning. A byte NN of a file name that is not UTF-8 "
    "is written as the six characters \\udcNN, and a backslash that begins such a sequence in the "
    "name itself as \\u005c."
)
_SIMPLE = {str: "string", int: "integer", bool: "boolean", types.NoneType: "null"}

Schema = dict[str, Any]


def build_schemas() -> dict[str, Schema]:
    """The schemas by file name: of a JSON report (a line of a JSON Lines report is its
    ``#/$defs/MeshRecord``), of ``msal info --json``, and of ``msal compare --json``, which prints
    for two files a ``#/$defs/ComparisonRecord``."""
    builder = _Builder()
    totals = builder.of(Totals) | {"description": "sums over the records"}
    run = {**builder.of_fields(Run)["properties"], "totals": totals}
    version = {"version": {"type": "string", "description": "version of msal"}}
    by_input = "one record per input file, in the order of the inputs"
    by_pair = "one record per pair of files, by relative path"
    compared = _Builder().document(
        "msal compare", ComparisonRecord.schema, version, ComparisonRecord, by_pair
    )
    several = {"required": compared.pop("required")}
    compared["anyOf"] = [several, {"$ref": "#/$defs/ComparisonRecord"}]
    return {
        "report.schema.json": builder.document("msal report", SCHEMA, run, MeshRecord, by_input),
        "info.schema.json": _Builder().document(
            "msal info", InfoRecord.schema, version, InfoRecord, by_input
        ),
        "compare.schema.json": compared,
    }


class _Builder:
    """Makes schemas of types, and keeps those of the dataclasses for ``$defs``."""

    def __init__(self) -> None:
        self._kinds: dict[str, Schema] = {}

    def document(
        self, title: str, name: str, head: Schema, kind: type[Any], description: str
    ) -> Schema:
        """The schema of a document with ``head`` and a list of records of one ``kind``."""
        records = {"type": "array", "items": self.of(kind), "description": description}
        schema = {"const": name, "description": "name and version of this schema"}
        properties = {"schema": schema, **head, "records": records}
        return {
            "$schema": _DIALECT,
            "$id": f"urn:{name.replace('/', ':')}",
            "title": f"{title} ({name})",
            "description": _NULL_NOTE,
            "type": "object",
            "properties": properties,
            "required": list(properties),
            "$defs": dict(sorted(self._kinds.items())),
        }

    def of_fields(self, kind: type[Any]) -> Schema:
        """The schema of a dataclass."""
        hints = typing.get_type_hints(kind)
        shared = {one.name: one.metadata for one in dataclasses.fields(MeshRecord)}
        properties = {}
        for one in dataclasses.fields(kind):
            typed = {"const": one.default} if one.name == "schema" else self.of(hints[one.name])
            text = (one.metadata or shared[one.name])["description"]
            properties[one.name] = typed | {"description": text}
        return {"type": "object", "properties": properties, "required": list(properties)}

    def of(self, hint: Any) -> Schema:
        """The schema of a type."""
        origin, inner = typing.get_origin(hint), typing.get_args(hint)
        if hint is Any:
            return {}
        if hint in _SIMPLE:
            return {"type": _SIMPLE[hint]}
        if hint is float:
            return {"type": ["number", "null"]}
        if dataclasses.is_dataclass(hint):
            kind = typing.cast("type[Any]", hint)
            if kind.__name__ not in self._kinds:
                first_line = (kind.__doc__ or "").partition("\n")[0]
                text = {"description": " ".join(first_line.split())}
                self._kinds[kind.__name__] = self.of_fields(kind) | text
            return {"$ref": f"#/$defs/{kind.__name__}"}
        if origin is Literal:
            return {"enum": list(inner)}
        if origin in (types.UnionType, typing.Union):
            options = [self.of(one) for one in inner]
            if any(set(option) != {"type"} for option in options):
                return {"anyOf": options}
            words = [option["type"] for option in options]
            flat = [one for word in words for one in ([word] if isinstance(word, str) else word)]
            return {"type": list(dict.fromkeys(flat))}
        if origin is tuple and inner[-1] is Ellipsis:
            return {"type": "array", "items": self.of(inner[0])}
        if origin is tuple:
            size = {"minItems": len(inner), "maxItems": len(inner)}
            return {"type": "array", "prefixItems": [self.of(one) for one in inner], **size}
        if origin in (dict, Mapping):
            return {"type": "object", "additionalProperties": self.of(inner[1])}
        raise TypeError(f"no schema for {hint}")


def main(folder: str | Path = Path(__file__).parent) -> None:
    """Write all schemas into a folder."""
    for name, schema in build_schemas().items():
        Path(folder, name).write_bytes(json_bytes(schema))


if __name__ == "__main__":
    main(*sys.argv[1:])
