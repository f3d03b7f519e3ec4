"""What each writer makes of one run with a file of every kind, kept in the folder ``golden``.

``python -m tests.report.golden`` writes the files anew; read their difference before committing.
"""

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path

from msal_cli.job import records
from msal_cli.report import build_services, comparison, data, facts, html, text
from tests.report.made import RUN, failed, gated, written

FOLDER = Path(__file__).with_name("golden")

NOISE = records.NoiseEstimate(
    mean_edges=0.12,
    file_units=0.03,
    low_edges=0.1,
    high_edges=0.14,
    rms_edges=0.15,
    tail=0.031,
    negligible=False,
    lowest_edges=0.05,
    highest_edges=0.2,
    regions=3,
    uneven=True,
    kind="white",
    rings=0,
    direction="normals",
    axis=None,
    step_edges=0.0,
    outliers=0.0,
    confidence=0.8,
    basis="the spectrum",
    words="noise along the normals",
    unsure=True,
    readings=(records.NoiseReading("noise", 0.12, 0.7), records.NoiseReading("texture", 0.0, 0.3)),
)
CHOICE = records.ChoiceMade(
    reason="noise 0.12 e; AL (3 sweeps)",
    surface="machined",
    noise_edges=0.12,
    risk_edges=0.07,
    tried=3,
    runners_up=(records.RunnerUp("MSAL, 2 sweeps", 0.08),),
    wishes={},
    repeat=("--method", "al", "--set", "iterations=3"),
    among="family",
    auto_seconds=2.6,
)
FULL = written(
    "scans/full.stl",
    corners=208_353,
    noise_estimate=NOISE,
    choice=CHOICE,
    boundary_edges=12,
    degenerate_faces=1,
    despiked=3,
    flipped_faces=1_234,
    clamped_vertices=1,
    locked_vertices=4,
    volume=records.Volume(1.0, 0.9, -0.1, -10.0, False, "open (12 boundary edges)"),
    gates=gated().gates,
    warnings=("colours are lost in stl (W_COLOURS)",),
    reference=records.Reference(
        "truth.ply", "vertices", mean_angular_error_deg=3.456, vertex_error_percent=2.0
    ),
    self_intersections=records.SelfIntersections(164, 145, 101),
    sidecars=("copied a.mtl",),
)
RECORDS = [
    FULL,
    written("scans/plain.ply"),
    failed("scans/bad.ply"),
    written("still.ply", status="unchanged", left_alone="noise below 0.01 e"),
    written("old.ply", status="up-to-date"),
    written("turned.ply", inside_out=True),
    records.MeshRecord("rest.ply", "planned", "out/rest.ply"),
]
HARDLY = dataclasses.replace(
    NOISE, mean_edges=0.001, file_units=0.0002, low_edges=0.0, negligible=True, unsure=False
)
UNMOVED = records.MethodUsed("msal", {"iterations": 0})
OPEN = records.Volume(None, None, None, None, False, "not orientable")
GATE = gated().gates[0]
PLANNED = records.Planned(2_000, 10, 8.0)
SEEN_SELDOM = [
    written("unsure.ply", corners=9, vertices=None, faces=3, components=2, noise_estimate=HARDLY),
    written("left.ply", noise_estimate=HARDLY, status="unchanged"),
    written("mild.ply", noise_estimate=NOISE, choice=CHOICE, status="unchanged"),
    written(
        "assumed.ply",
        noise_estimate=NOISE,
        choice=dataclasses.replace(CHOICE, auto_seconds=None, wishes={"assume": "noise"}),
    ),
    written(
        "as it was.ply",
        noise_estimate=HARDLY,
        left_alone="no noise",
        method=records.MethodUsed("none", {}),
    ),
    written("despiked.ply", despiked=1, locked_vertices=0, volume=OPEN),
    written("open.ply", volume=OPEN, boundary_edges=2, noise_estimate=HARDLY, method=UNMOVED),
    written("passed.ply", gates=(dataclasses.replace(GATE, broken=False),)),
    written("undecided.ply", gates=(dataclasses.replace(GATE, decided=False),)),
    written("near.ply", reference=records.Reference("t.ply", hausdorff_edges=0.5)),
    written("no truth.ply", reference=records.Reference("t.ply", error=failed().error)),
    written("odd truth.ply", reference=records.Reference("t.ply", warnings=("odd",))),
    written("-", output="-"),
    records.MeshRecord("next.ply", "planned", "out/next.ply", planned=PLANNED),
    records.MeshRecord(
        "then.ply", "planned", "out/then.ply", planned=dataclasses.replace(PLANNED, seconds=2.0)
    ),
]
"""Records whose facts are others than those of a file that went well."""

INFO = records.InfoRecord(
    input="scan.ply",
    format="ply",
    encoding="ascii",
    precision="float32",
    compressed=True,
    bytes=123456,
    vertices=1000,
    corners=6000,
    faces=1500,
    polygon_sizes={"3": 1000, "4": 499, "12": 2, "5": 1},
    components=2,
    closed=False,
    boundary_edges=12,
    non_manifold_edges=3,
    winding="inconsistent",
    bounds=((0.0, -1.0, 4650000.125), (1.0, 1.0, 4650003.125)),
    area=12.5,
    volume=3.0,
    volume_valid=False,
    volume_reason="open (12 boundary edges)",
    mean_edge_length=0.25,
    noise_estimate=NOISE,
    properties=("vertex.quality float",),
    references=("a\x1b.mtl",),
    warnings=("odd",),
)
CLOSED = records.InfoRecord(
    input="ball.ply", format="ply", closed=True, volume_valid=True, volume=3.0, inside_out=True
)
PAIR = records.ComparisonRecord(
    before="a.ply",
    after="b.ply",
    correspondence="vertices",
    vertices_before=10,
    vertices_after=10,
    faces_before=16,
    faces_after=16,
    mean_edge_length=0.5,
    mean_angular_error_deg=3.456,
    max_angular_error_deg=20.0,
    vertex_error_percent=2.5,
    displacement=FULL.displacement,
    volume=records.Volume(10.0, 9.0, -1.0, -10.0, True, ""),
    volume_change_percent=-10.0,
    area_change_percent=1.25,
    flipped_faces=1_234,
    hausdorff=0.25,
    hausdorff_edges=0.5,
    self_intersections=records.SelfIntersections(1, 2, None),
    warnings=("their windings differ",),
)
UNLIKE = records.ComparisonRecord("a.ply", "c.ply", error=failed().error)


def outputs() -> Iterator[tuple[str, str]]:
    """The name of each file and what is in it."""
    yield "one.txt", lines(text.summary(RUN, [RECORDS[1]], defaults={"K": 0.5, "iterations": 6}))
    yield "all_of_one.txt", lines(text.summary(RUN, [FULL], verbose=True))
    yield "summary.txt", lines(text.summary(RUN, RECORDS))
    yield "summary_verbose.txt", lines(text.summary(RUN, RECORDS, verbose=True))
    every, usual = [*SEEN_SELDOM, *RECORDS], facts.list_facts(RECORDS[1])
    yield (
        "facts.txt",
        "".join(
            f"{record.input}, level {fact.level}: {fact.word}: {fact.text}\n"
            for record in every
            for fact in facts.list_facts(record)
            if fact not in usual
        ),
    )
    yield "first_lines.txt", lines(text.summary(RUN, [record])[0] for record in every)
    outlooks = [text.outlook(every, n_cores) for n_cores in (1, 4)]
    yield "dry_run.txt", lines([*text.listing(every), *outlooks])
    better = ([], [FULL], [FULL, RECORDS[1], FULL], 100 * [FULL])
    yield "better_by_auto.txt", "".join(f"{facts.auto_text(several)}\n" for several in better)
    cut = dataclasses.replace(RUN, interrupted=True)
    every = [*text.summary(cut, RECORDS[-3:]), *text.summary(cut, RECORDS[-1:])]
    yield "cut_short.txt", "".join(f"{line.tone}: {line.text}\n" for line in every)
    spans = (0.0, 9.994, 12.34, 99.96, 185.4, 3599.9, 7800.0)
    yield "seconds.txt", "".join(f"{span}: {facts.seconds_text(span)}\n" for span in spans)
    yield "info.txt", lines([*text.describe_info(INFO), *text.describe_info(CLOSED)])
    yield "info_table.txt", lines(text.info_table([INFO, CLOSED], ["scan.ply", "ball.ply"], 80))
    yield "compare.txt", lines(comparison.describe_comparison(PAIR))
    yield "compare_table.txt", lines(comparison.comparison_table([PAIR, UNLIKE], width=90))
    yield "report.md", build_services.render_markdown(RUN, RECORDS).decode()
    yield "report.xml", build_services.render_junit(RUN, RECORDS).decode()
    yield "annotations.txt", "\n".join([*build_services.list_annotations(RECORDS), ""])
    columns, rows = html.build_table(facts.worst_first(RECORDS))
    table_lines = (json.dumps(line, ensure_ascii=False) for line in (columns, *rows))
    yield "table.jsonl", "".join(f"{line}\n" for line in table_lines)
    page = html.render(RUN, RECORDS).decode()
    body = page.partition("<body>")[2].partition('<script type="application/json"')[0]
    yield "page.html", re.sub("(?=<(?:section|tr|p|figure)[ >])", "\n", body)
    header, _, _ = data.render_csv(RUN, RECORDS, has_all=True).decode().partition("\r\n")
    yield "columns.txt", header.replace(",", "\n") + "\n"
    yield "report.csv", data.render_csv(RUN, RECORDS).decode()


def lines(several: object) -> str:
    return "".join(f"{line.text}\n" for line in several)  # type: ignore[attr-defined]


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, made in outputs():
        (FOLDER / name).write_text(made, encoding="utf-8", newline="")
