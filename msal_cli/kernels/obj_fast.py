"""A walk over the statements of an OBJ file that are plainly written: nearly all, in most files.

It goes on until it meets one that is not, and leaves that to others: ``obj_scan`` knows everything
and takes longer, above all to be compiled.  Plain are comments and v, vt, vn and f on one line
without a backslash whose numbers are plain and whose corners, three and more, are positive.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.byte_words import count_before, count_digits, load_eight, parse_digits
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.digits import EXACT, read_number
from msal_cli.kernels.obj_scan import (
    AT,
    COLOURED,
    CORNERS,
    FACES,
    FULL,
    LARGEST_VERTEX,
    NORMALS,
    TEXTURE,
    VERTICES,
    WHOLE,
)

ODD = -1
"""The statement at ``state[AT]`` is not plain."""

_BLOCK = 16_384


@compiled
def counted(buf):  # type: ignore[no-untyped-def]
    """At least as many v, vn and f statements as there are, hardly more in any real file; zeros."""
    # The first and the last byte are looked at as neighbours only.
    n_vertices = n_normals = n_faces = 2
    n_zeros = 0
    # Block by block, so that the second and third look find it in the cache; in plain sums, so
    # that they become vector code.
    for begin in range(0, len(buf), _BLOCK):
        block = buf[max(begin - 1, 0) : begin + _BLOCK + 1]
        vertices = faces = normals = zeros = 0
        for i in range(1, len(block) - 1):
            is_first = block[i - 1] <= 32
            is_short = (block[i + 1] <= 32) | (block[i + 1] == 92)
            vertices += (block[i] == 118) & is_first & is_short
            faces += (block[i] == 102) & is_first & is_short
            normals += (block[i - 1] == 118) & (block[i] == 110)
            zeros += block[i] == 0
        n_vertices += vertices
        n_faces += faces
        n_normals += normals
        n_zeros += zeros
    if len(buf) < 2 or buf[-2] != 118 or buf[-1] != 110:
        n_normals -= 1
    return n_vertices, n_normals, n_faces, n_zeros


@compiled
def _past_line(buf, at, is_comment):  # type: ignore[no-untyped-def]
    """The end of the line; -1 where a backslash is on the way, which only comments may have."""
    high = np.uint64(0x8080808080808080)
    while at < len(buf):
        word = load_eight(buf, at)
        # Marked are bytes below 14, of which line ends are two, and backslashes.
        slashes = word ^ np.uint64(0x5C5C5C5C5C5C5C5C)
        found = (word - np.uint64(0x0E0E0E0E0E0E0E0E)) & ~word
        found |= (slashes - np.uint64(0x0101010101010101)) & ~slashes
        found &= high
        if found == 0:
            at += 8
            continue
        at += count_before(found)
        if at >= len(buf):
            break
        c = buf[at]
        if c == 10 or c == 13:
            return at
        if c == 92 and not is_comment:
            return -1
        at += 1
    return len(buf)


@compiled
def _past_blanks(buf, at):  # type: ignore[no-untyped-def]
    while at < len(buf) and (buf[np.uint64(at)] == 32 or buf[np.uint64(at)] == 9):
        at += 1
    return at


@compiled
def _is_line_end(buf, at):  # type: ignore[no-untyped-def]
    return at >= len(buf) or buf[np.uint64(at)] == 10 or buf[np.uint64(at)] == 13


@compiled
def walked(  # type: ignore[no-untyped-def]
    buf,
    state,
    vertices,
    vertex_at,
    decimals,
    normals,
    normal_at,
    normal_decimals,
    corners,
    corner_normals,
    face_sizes,
):
    """Read on from ``state`` as far as statements are plain; returns WHOLE, FULL or ODD.

    Parameters as in ``obj_scan.scanned``.
    """
    at = state[AT]
    n_vertices, n_normals = state[VERTICES], state[NORMALS]
    n_faces, n_corners = state[FACES], state[CORNERS]
    result = WHOLE
    statement = at
    while True:
        while at < len(buf) and _is_line_end(buf, at):
            at += 1
        statement = at = _past_blanks(buf, at)
        if at >= len(buf):
            break
        if _is_line_end(buf, at):
            continue
        first = buf[at]
        # Both bytes behind the end of the file are as good as the end of a line.
        second = buf[at + 1] if at + 1 < len(buf) else np.uint8(10)
        third = buf[at + 2] if at + 2 < len(buf) else np.uint8(10)
        if first == 102 and (second == 32 or second == 9):
            if n_faces == len(face_sizes):
                result = FULL
                break
            at += 1
            corner = n_corners
            while True:
                at = _past_blanks(buf, at)
                if _is_line_end(buf, at):
                    break
                normal = np.int64(-1)
                for part in range(3):
                    word = load_eight(buf, at)
                    count = count_digits(word)
                    at += count
                    if count > 0:
                        number = parse_digits(word, count) - 1
                        if number < 0 or count == 8:
                            result = ODD
                        # The largest numbers of vt and vn, which come next, are kept from one.
                        seen = number if part == 0 else number + 1
                        if seen > state[LARGEST_VERTEX + part]:
                            state[LARGEST_VERTEX + part] = seen
                        if part == 0:
                            if corner == len(corners):
                                result = FULL
                                break
                            corners[corner] = number
                        else:
                            normal = number if part == 2 else normal
                    elif part == 0:
                        result = ODD
                    if part == 2 or at >= len(buf) or buf[np.uint64(at)] != 47:
                        break
                    at += 1
                if result == WHOLE and at < len(buf) and buf[np.uint64(at)] > 32:
                    result = ODD
                if result != WHOLE:
                    break
                if len(corner_normals):
                    corner_normals[corner] = normal
                corner += 1
            if result == WHOLE and corner - n_corners < 3:
                result = ODD
            if result != WHOLE:
                break
            face_sizes[n_faces] = corner - n_corners
            n_faces += 1
            n_corners = corner
        elif first == 118 and (second == 32 or second == 9 or second == 110):
            is_normal = second == 110
            room = len(normal_at) - n_normals if is_normal else len(vertex_at) - n_vertices
            if is_normal and third != 32 and third != 9:
                result = ODD
            elif room == 0:
                result = FULL
            at += 2 if is_normal else 1
            x = y = z = w = 0.0
            most = np.int64(0)
            count = 0
            while result == WHOLE and count < 5:
                at = _past_blanks(buf, at)
                if _is_line_end(buf, at):
                    break
                value, status, end, used = read_number(buf, at, len(buf))
                if status != EXACT or (end < len(buf) and buf[np.uint64(end)] > 32):
                    result = ODD
                at = end
                if count < 3:
                    x, y, z = y, z, value
                    most = max(most, used)
                w = value
                count += 1
            if result == WHOLE and (count < 3 or (count == 4 and not is_normal and w != 1.0)):
                result = ODD
            if result != WHOLE:
                break
            if count == 5:
                at = _past_line(buf, at, first == 35)
                if at < 0:
                    result = ODD
                    break
            if is_normal:
                normals[n_normals, 0] = x
                normals[n_normals, 1] = y
                normals[n_normals, 2] = z
                normal_at[n_normals] = statement
                normal_decimals[n_normals] = most
                n_normals += 1
            else:
                vertices[n_vertices, 0] = x
                vertices[n_vertices, 1] = y
                vertices[n_vertices, 2] = z
                vertex_at[n_vertices] = statement
                decimals[n_vertices] = most
                n_vertices += 1
                state[COLOURED] += count == 5
        else:
            is_texture = first == 118 and second == 116 and (third == 32 or third == 9)
            if not is_texture and first != 35:
                result = ODD
                break
            at = _past_line(buf, at, first == 35)
            if at < 0:
                result = ODD
                break
            state[TEXTURE] += is_texture
    state[AT] = statement
    state[VERTICES], state[NORMALS] = n_vertices, n_normals
    state[FACES], state[CORNERS] = n_faces, n_corners
    return result
