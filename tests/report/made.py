"""Records of every kind, made from the types of their fields, and their published schemas."""

import dataclasses
import json
import math
import types
import typing
from pathlib import Path
from random import Random

from hypothesis import strategies as st

from msal_cli.job import records
from msal_cli.job.records import Run

TEXTS = ["=1+1", "\ufffe", "\\udcff", "\\u005c", "a\r\nb", "'quoted", 'a"b,c', "\u2028", ""]
FLOATS = [0.0, -0.0, 1.5, -3.0, 0.1, 1e300, -1.7e308, 5e-324, math.nan, math.inf, -math.inf]


HOSTILE_NAMES = (
    "=cmd|' call'!A0.ply",
    "+1+1.ply",
    "@SUM(1).ply",
    "-1-1.ply",
    "<script>alert(1)<!-- .ply",
    '"><img src=x onerror=alert(1)>.ply',
    "a|b|c.ply",
    "`id`$(id).ply",
    "]]>.ply",
    "%0A::error::x.ply",
    "::warning file=a,line=1::x.ply",
    "\x1b]0;title\x07\x1b[2J.ply",
    "\u202eylp.exe\u2066.ply",
    "line\n::error::break\r.ply",
    'comma,"quote"\'.ply',
    "##vso[task.setvariable variable=x]y.ply",
    " ::add-mask::x.ply",
    "{{7*7}}${7*7}<%= 7*7 %>.ply",
    "[link](javascript:alert(1))**b**_i_.ply",
    "&amp;&#10;&lt;.ply",
)
"""Names of files that readers of reports must take for names: no formula, markup or command.

No slash can be in a name.
"""


def any_text(random: Random) -> str:
    """Text of any characters, lone surrogates among them."""
    ends = random.choices([0x80, 0x3000, 0x110000], k=random.randint(0, 12))
    text = "".join(chr(random.choice([random.randrange(end), 0xDCFF])) for end in ends)
    return random.choice([text, text, random.choice(TEXTS)])


def any_value(random: Random, kind):
    """A value of a type as the records use it."""
    simple = {
        str: lambda: any_text(random),
        int: lambda: random.choice([0, 1, 2**53, random.randrange(2**53)]),
        float: lambda: random.choice([*FLOATS, random.gauss(0, 10)]),
        bool: lambda: random.random() < 0.5,
        typing.Any: lambda: any_value(random, random.choice([str, int, float])),
        type(None): lambda: None,
    }
    if kind in simple:
        return simple[kind]()
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        fields = {
            one.name: one.default if one.name == "schema" else any_value(random, hints[one.name])
            for one in dataclasses.fields(kind)
        }
        return kind(**fields)
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Literal:
        return random.choice(inner)
    if origin in (types.UnionType, typing.Union):
        return any_value(random, random.choice(inner))
    if origin is tuple and inner[-1] is not Ellipsis:
        return tuple(any_value(random, one) for one in inner)
    n = random.randint(0, 3)
    if origin is tuple:
        return tuple(any_value(random, inner[0]) for _ in range(n))
    return {any_value(random, inner[0]): any_value(random, inner[1]) for _ in range(n)}


def any_records(random: Random) -> list[records.MeshRecord]:
    return [any_value(random, records.MeshRecord) for _ in range(random.randint(0, 2))]


RECORDS = st.builds(any_records, st.randoms(use_true_random=True))


RUN = Run(
    version="1.2.3",
    command=("msal", "denoise", "scans", "-o", "an out"),
    settings={"method": "msal", "parameters": {"K": 0.5}, "to": None},
    started="2026-01-02T03:04:05.678Z",
    finished="2026-01-02T03:04:15.678Z",
    seconds=10.0,
)


def written(name="scan.ply", **changes):
    """The record of a file that went well, with ``changes``."""
    values = {
        "input": name,
        "status": "written",
        "output": f"out/{name}",
        "version": "1.2.3",
        "format": "ply",
        "encoding": "ascii",
        "precision": "float32",
        "vertices": 35947,
        "faces": 69451,
        "triangles": 69451,
        "components": 1,
        "boundary_edges": 0,
        "non_manifold_edges": 0,
        "volume": records.Volume(10.0, 9.9734, -0.0266, -0.266, True, ""),
        "displacement": records.Displacement(0.1, 0.2, 0.3, 0.4, 0.11, 0.22, 0.33, 0.44, 35000),
        "method": records.MethodUsed("msal", {"iterations": 4, "K": 0.5}),
        "seconds": records.Seconds(0.1, 0.2, 0.0, 0.05, 0.3, 0.1, 0.2, 0.95),
    }
    return records.MeshRecord(**(values | changes))


def failed(name="bad.ply", **changes):
    """The record of a file that failed."""
    failure = records.Failure("E_NONFINITE", "position is not finite", "repair it", "vertex 17")
    return records.MeshRecord(**({"input": name, "status": "failed", "error": failure} | changes))


def gated(name="gated.ply", **changes):
    """The record of a file that was written and broke one of its two gates."""
    gates = (
        records.GateResult(
            "abs(volume_change) > 1%", True, True, {"volume_change": -2.1}, "volume_change is -2.1%"
        ),
        records.GateResult(
            "flipped_faces > 0", False, True, {"flipped_faces": 0.0}, "flipped_faces is 0"
        ),
    )
    return written(name, **({"gates": gates} | changes))


DOCS = Path(__file__).parents[2] / "docs"


def load_schema(name):
    """The published JSON Schema of a name: report, info or compare."""
    return json.loads((DOCS / f"{name}.schema.json").read_bytes())
