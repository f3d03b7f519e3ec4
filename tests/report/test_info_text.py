"""What `msal info` tells people."""

from __future__ import annotations

from msal_cli.job.info_record import InfoRecord
from msal_cli.job.records import Failure, NoiseEstimate
from msal_cli.report import info_text


def made(**changes):
    values = {
        "input": "scan.ply",
        "format": "ply",
        "encoding": "ascii",
        "precision": "float32",
        "compressed": True,
        "bytes": 123456,
        "vertices": 1000,
        "faces": 1500,
        "polygon_sizes": {"3": 1000, "4": 499, "12": 2, "5": 1},
        "components": 2,
        "closed": False,
        "boundary_edges": 12,
        "non_manifold_edges": 3,
        "winding": "inconsistent",
        "bounds": ((0.0, -1.0, 4650000.125), (1.0, 1.0, 4650003.125)),
        "area": 12.5,
        "volume": 3.0,
        "volume_valid": False,
        "volume_reason": "open (12 boundary edges)",
        "mean_edge_length": 0.25,
        "noise_estimate": NoiseEstimate(0.1, 0.025),
        "properties": ("vertex.quality float",),
        "references": ("a\x1b.mtl",),
        "warnings": ("odd",),
    }
    return InfoRecord(**(values | changes))


def facts(record):
    lines = [line.text for line in info_text.describe_info(record)]
    return lines[0], {line[2:17].strip(): line[18:] for line in lines[1:]}


def test_everything_is_told():
    name, told = facts(made())
    assert name == "scan.ply"
    assert told["format"] == "ply, ascii, float32, gzip, 123,456 bytes"
    assert (
        told["faces"] == "1,500 (1,000 triangles, 499 quads, 1 with 5 corners, 2 with 12 corners)"
    )
    assert told["surface"] == "open, 12 boundary edges, 3 non-manifold edges"
    assert told["to"] == "1, 1, 4650003.12"
    assert told["size"] == "1 x 2 x 3"
    assert told["noise estimate"] == "0.1 mean edge lengths (0.025 in file units)"
    assert told["refers to"] == "a\\x1b.mtl"
    assert told["warning"] == "odd"


def test_a_volume_is_told_only_if_it_can_be_trusted():
    assert facts(made())[1]["volume"] == "- open (12 boundary edges)"
    closed = made(closed=True, volume_valid=True, non_manifold_edges=0)
    assert facts(closed)[1]["volume"] == "3"
    assert facts(closed)[1]["surface"] == "closed"


def test_a_failure_is_told_with_its_hint():
    record = InfoRecord("x.ply", error=Failure("E_TRUNCATED", "it ends early", "copy it", "byte 9"))
    assert [line.text for line in info_text.describe_info(record)] == [
        "x.ply: byte 9: it ends early (E_TRUNCATED)",
        "  hint: copy it",
    ]


def noise(**changes):
    values = {
        "mean_edges": 0.1,
        "file_units": 0.025,
        "low_edges": 0.09,
        "high_edges": 0.115,
        "rms_edges": 0.1,
        "tail": 0.01,
        "negligible": False,
        "lowest_edges": 0.05,
        "highest_edges": 0.2,
        "regions": 8,
        "uneven": False,
    }
    return NoiseEstimate(**(values | changes))


def test_noise_is_told_with_its_interval_and_what_is_peculiar_about_it():
    def lines(estimate):
        told = [line.text[18:] for line in info_text.describe_info(made(noise_estimate=estimate))]
        (first,) = [at for at, one in enumerate(told) if "in file units" in one]
        return told[first:]

    text = "0.1 mean edge lengths, 0.09 to 0.12 (0.025 in file units)"
    assert lines(noise())[0] == text
    assert lines(noise(negligible=True, uneven=True))[0] == f"{text}: none to speak of"
    uneven, impulsive = lines(noise(uneven=True, tail=0.031, rms_edges=0.15))[1:3]
    assert uneven == "uneven: 0.05 to 0.2 by region"
    assert impulsive.startswith("impulsive: 3.1 % of the vertices stand out; with them 0.15 mean")


def test_inside_out_is_told_with_the_volume_that_is_enclosed():
    said = facts(made(volume=3.0, volume_valid=True, volume_reason="", inside_out=True))[1]
    assert said["volume"] == "3 (inside out)"
    assert said["winding"].endswith(", inside out")


def test_corners_stand_beside_the_vertices():
    assert facts(made(corners=6000))[1]["vertices"] == "1,000 (of 6,000 corners)"
