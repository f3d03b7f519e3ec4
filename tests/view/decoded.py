"""A scene read back in Python, step by step as the page's script does it (assets/decoding.js)."""

import base64
import json
import struct
import zlib

import numpy as np


def decoded(text):
    """Header, [(ticks (n, 3), faces (m, 3)), ...] and deviations (n,) or None."""
    raw = zlib.decompress(base64.b64decode(text, validate=True))
    (length,) = struct.unpack_from("<I", raw)
    header = json.loads(raw[4 : 4 + length])
    at = 4 + length

    def numbers(count, ranks):
        nonlocal at
        planes = np.frombuffer(raw, np.uint8, count * ranks, at).reshape(ranks, count)
        at += count * ranks
        return sum(plane.astype(np.int64) << (8 * rank) for rank, plane in enumerate(planes))

    def steps(count):
        codes = np.stack([numbers(count, 3) for _ in range(3)], axis=1)
        return (codes >> 1) ^ -(codes & 1)

    meshes = []
    for one in header["meshes"]:
        if one.get("moved"):
            ticks, faces = meshes[0]
            meshes.append((ticks + steps(one["vertices"]), faces))
            continue
        corners = numbers(3 * one["faces"], 3)
        known = 0
        for c in range(len(corners)):
            corners[c] = known - corners[c]
            known += corners[c] == known
        ticks = np.cumsum(steps(one["vertices"]), axis=0)
        meshes.append((ticks, corners.reshape(-1, 3)))
    deviation = None
    if "deviation" in header:
        scale = header["deviation"]
        deviation = scale["least"] + numbers(len(meshes[-1][0]), 2) / 65535 * scale["span"]
    for one in header["meshes"]:
        at += 3 * one["vertices"] * bool(one.get("painted"))
    assert at == len(raw)
    return header, meshes, deviation
