"""One pass over the bytes of an OBJ file: positions, normals, faces and other statements.

A *line* ends at a line feed or a carriage return, so CR LF ends it twice, which is harmless,
because empty lines mean nothing.  A backslash before the end of a line continues it, but not in a
comment (a path that ends in one would swallow the next vertex).  The bytes are untrusted and
compiled code does not check bounds: each step here compares with the end of the data.
"""

import numpy as np

from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.numbers import EXACT, NOT_A_NUMBER, UNDECIDED, read_number
from msal_cli.kernels.text import read_integer, read_short_integer, skip_line

(
    WHOLE,  # all of the text is read
    FULL,  # an output array is full; call again with larger ones
    BAD_NUMBER,  # a word that must be a number is not
    FEW_NUMBERS,  # a position or a normal has fewer than three numbers
    BAD_CORNER,  # a corner of a face is not v, v/vt, v//vn or v/vt/vn
    BAD_INDEX,  # a face names vertex 0 or one before the first
    NO_CORNERS,  # a face has nothing after its keyword
) = range(7)

(
    AT,  # first byte not yet read; with an error, the statement that is wrong
    VERTICES,
    NORMALS,
    TEXTURE,  # vt statements
    FACES,  # those with three corners and more
    CORNERS,
    UNDECIDED_ROWS,
    LARGEST_VERTEX,  # largest vertex index of a face, from zero
    LARGEST_TEXTURE,  # largest vt and vn numbers, from one
    LARGEST_NORMAL,
    BEFORE_FIRST,  # vt and vn numbers of faces that are zero or lie before the first
    SHORT,  # faces of one or two corners
    SHORT_AT,
    LAST_SHORT_AT,
    LAST_FACE_AT,
    WEIGHTED,  # positions with w other than one
    WEIGHTED_AT,
    COLOURED,  # positions with more than four numbers
    KEYWORDS,  # different other keywords
    LIBRARIES,  # mtllib statements
    WORD,  # with an error: first byte of the word that is wrong
    N_STATE,
) = range(22)

MAX_KEYWORDS = 64
"""Largest number of different other keywords; the last row counts all further ones."""

MAX_LIBRARIES = 1024
"""Largest number of ``mtllib`` statements."""

_BLOCK = 16_384

MTLLIB = np.uint64(int.from_bytes(b"mtllib", "big"))


@compiled
def count_statements(buf):
    """Upper bounds of the numbers of v, vn and f statements, close for real files; and zeros."""
    # The first and the last byte are used as neighbours only.
    n_vertices = n_normals = n_faces = 2
    n_zeros = 0
    # Block by block, so that later passes find it in the cache; as sums, for vector code.
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
def skip_blanks(buf, at):
    """The next byte that is not a blank; a continued line goes on after its end."""
    while at < len(buf):
        c = buf[at]
        if c == 32 or c == 9 or c == 11 or c == 12:
            at += 1
        elif c == 92 and at + 1 < len(buf) and (buf[at + 1] == 10 or buf[at + 1] == 13):
            at += 2
            if buf[at - 1] == 13 and at < len(buf) and buf[at] == 10:
                at += 1
        else:
            break
    return at


@compiled
def is_word_end(buf, at):
    """Whether a word ends before ``at``: a blank, the end of a line, or a continuation."""
    if at >= len(buf):
        return True
    c = buf[at]
    if c == 32 or c == 10:
        return True
    if c == 92:
        return at + 1 < len(buf) and (buf[at + 1] == 10 or buf[at + 1] == 13)
    return 9 <= c <= 13


@compiled
def skip_word(buf, at):
    """The end of the word at ``at``."""
    while True:
        while at < len(buf) and buf[at] > 32 and buf[at] != 92:
            at += 1
        if is_word_end(buf, at):
            return at
        at += 1


@compiled
def _is_statement_end(buf, at):
    """Whether no word begins at ``at``, which is not a blank: the line ends or a comment begins."""
    return at >= len(buf) or buf[at] == 10 or buf[at] == 13 or buf[at] == 35


@compiled
def _skip_line(buf, at):
    """The end of the line, or of the lines that continue it; ``at`` is after a word."""
    is_comment = False
    while at < len(buf):
        c = buf[at]
        if c == 35:
            is_comment = is_comment or buf[at - 1] <= 32
        elif c == 10 or c == 13:
            if is_comment or buf[at - 1] != 92:
                break
            at = skip_blanks(buf, at - 1)
            continue
        at += 1
    return at


@compiled
def read_coordinate(buf, at):
    """The number at ``at``, which must be a whole word: value, status, end, decimals.

    ``1.#QNAN``, ``-1.#IND`` and ``1.#INF``, as old run-time libraries print them, are NaN.
    """
    value, status, end, decimals = read_number(buf, at, len(buf))
    if not is_word_end(buf, end):
        if status != NOT_A_NUMBER and buf[end] == 35 and buf[end - 1] == 46:
            return np.nan, EXACT, skip_word(buf, end), 0
        return value, NOT_A_NUMBER, end, 0
    return value, status, end, decimals


@compiled
def _read_three(buf, at):
    """The three numbers after ``at``: values, WHOLE or an error, end, decimals, whether UNDECIDED.

    With an error the end is where the wrong word begins.
    """
    point = vec.ORIGIN
    most_decimals = np.int64(0)
    is_undecided = False
    for _ in range(3):
        at = skip_blanks(buf, at)
        value, status, end, decimals = read_coordinate(buf, at)
        if status == NOT_A_NUMBER:
            result = FEW_NUMBERS if _is_statement_end(buf, at) else BAD_NUMBER
            return point, result, at, most_decimals, is_undecided
        is_undecided |= status == UNDECIDED
        most_decimals = max(most_decimals, decimals)
        point = point[1], point[2], value
        at = end
    return point, WHOLE, at, most_decimals, is_undecided


@compiled
def _resolve_index(number, count):
    """The index, from zero, that ``number`` of a face means after ``count`` entries; or -1."""
    if number > 0:
        return min(number, 1 << 31) - 1
    if number < 0 and number + count >= 0:
        return number + count
    return np.int64(-1)


@compiled
def pack_word(buf, at, stop):
    """The first eight bytes of a keyword as one number."""
    word = np.uint64(0)
    for k in range(at, min(stop, at + 8)):
        word = (word << np.uint64(8)) | np.uint64(buf[k])
    return word


@compiled
def note_keyword(buf, at, stop, keywords, n_keywords):
    """Count a keyword in its row (word, times, first byte, size); returns the rows in use."""
    word = np.int64(pack_word(buf, at, stop))
    row = 0
    while row < n_keywords and (keywords[row, 0] != word or keywords[row, 3] != stop - at):
        row += 1
    if row == n_keywords:
        if n_keywords == len(keywords):
            row -= 1
        else:
            keywords[row, 0] = word
            keywords[row, 1] = 0
            keywords[row, 2] = at
            keywords[row, 3] = stop - at
            n_keywords += 1
    keywords[row, 1] += 1
    return n_keywords


@compiled
def scan(
    buf,
    state,
    n_faces_wanted,
    vertices,
    vertex_at,
    decimals,
    normals,
    normal_at,
    normal_decimals,
    corners,
    corner_normals,
    face_sizes,
    undecided,
    keywords,
    libraries,
):
    """Continue from ``state`` until a decision is needed; returns WHOLE, FULL or an error.

    Parameters
    ----------
    buf : (size,) uint8, the file.
    state : (N_STATE,) int64, see the names above; at the start zeros but for AT.
    n_faces_wanted : stop before the next face once this many are read.
    vertices, vertex_at, decimals : (n, 3) float64; where each statement begins, (n,) int64; and
        the most decimals of its numbers, (n,) uint8, 255 for more.
    normals, normal_at, normal_decimals : the same for vn.
    corners, corner_normals : (k,) int32, vertex and normal of each corner, from zero; -1 for no
        normal.  ``corner_normals`` is empty where the file has no normals.
    face_sizes : (m,) int32, corners of each face.
    undecided : (u, 2) int64, statements whose numbers ``float`` must read: 0 for a position or 1
        for a normal, and its row.
    keywords : (MAX_KEYWORDS, 4) int64, see ``note_keyword``.
    libraries : (MAX_LIBRARIES,) int64, where the mtllib statements begin.
    """
    at = state[AT]
    n_vertices, n_normals = state[VERTICES], state[NORMALS]
    n_faces, n_corners = state[FACES], state[CORNERS]
    n_undecided = state[UNDECIDED_ROWS]
    largest = state[LARGEST_VERTEX]
    last_face = state[LAST_FACE_AT]
    result = WHOLE
    while True:
        while at < len(buf) and (buf[at] == 32 or 9 <= buf[at] <= 13):
            at += 1
        if at >= len(buf):
            break
        statement = at
        first = buf[at]
        if first == 35:
            at = skip_line(buf, at)
            continue
        second = buf[at + 1] if first == 118 and at + 1 < len(buf) else np.uint8(32)
        is_normal = second == 110 and is_word_end(buf, at + 2)
        if first == 118 and (is_normal or is_word_end(buf, at + 1)):
            rows = len(normal_at) - n_normals if is_normal else len(vertex_at) - n_vertices
            if rows == 0 or n_undecided == len(undecided):
                result = FULL
                break
            at += 2 if is_normal else 1
            point, result, at, most, is_undecided = _read_three(buf, at)
            if result == WHOLE and not is_normal:
                at = skip_blanks(buf, at)
                if not _is_statement_end(buf, at):
                    value, status, end, _ = read_coordinate(buf, at)
                    more = skip_blanks(buf, end)
                    if status == NOT_A_NUMBER:
                        result = BAD_NUMBER
                    elif not _is_statement_end(buf, more):
                        state[COLOURED] += 1
                    elif value != 1.0:
                        if state[WEIGHTED] == 0:
                            state[WEIGHTED_AT] = statement
                        state[WEIGHTED] += 1
            if result != WHOLE:
                state[WORD] = at
                at = statement
                break
            if is_undecided:
                undecided[n_undecided, 0] = is_normal
                undecided[n_undecided, 1] = n_normals if is_normal else n_vertices
                n_undecided += 1
            if is_normal:
                vec.store(normals, n_normals, point)
                normal_at[n_normals] = statement
                normal_decimals[n_normals] = min(most, 255)
                n_normals += 1
            else:
                vec.store(vertices, n_vertices, point)
                vertex_at[n_vertices] = statement
                decimals[n_vertices] = min(most, 255)
                n_vertices += 1
            at = _skip_line(buf, at)
        elif first == 102 and (
            is_word_end(buf, at + 1) or (buf[at + 1] == 111 and is_word_end(buf, at + 2))
        ):
            # fo is the name that early versions of the format had for f.
            if n_faces == n_faces_wanted:
                break
            if n_faces == len(face_sizes):
                result = FULL
                break
            at += 1 if is_word_end(buf, at + 1) else 2
            first_corner, word = n_corners, at
            before_first = state[BEFORE_FIRST]
            while True:
                # A short path for corners v, the only ones in many files.
                if at + 1 < len(buf) and buf[at] == 32 and n_corners < len(corners):
                    number, digits = read_short_integer(buf, at + 1)
                    if number > 0:
                        largest = max(largest, number - 1)
                        corners[n_corners] = number - 1
                        if len(corner_normals):
                            corner_normals[n_corners] = -1
                        n_corners += 1
                        at += 1 + digits
                        continue
                at = skip_blanks(buf, at)
                if _is_statement_end(buf, at):
                    break
                if n_corners == len(corners):
                    result = FULL
                    break
                word = at
                number, at, _ = read_integer(buf, at, len(buf))
                if at == word:
                    result = BAD_CORNER
                    break
                normal = np.int64(-1)
                if at < len(buf) and buf[at] == 47:
                    begin = at + 1
                    number_t, at, _ = read_integer(buf, begin, len(buf))
                    if at > begin:
                        if number_t > state[LARGEST_TEXTURE]:
                            state[LARGEST_TEXTURE] = number_t
                        if _resolve_index(number_t, state[TEXTURE]) < 0:
                            state[BEFORE_FIRST] += 1
                    if at < len(buf) and buf[at] == 47:
                        begin = at + 1
                        number_n, at, _ = read_integer(buf, begin, len(buf))
                        if at > begin:
                            if number_n > state[LARGEST_NORMAL]:
                                state[LARGEST_NORMAL] = number_n
                            normal = _resolve_index(number_n, n_normals)
                            if normal < 0:
                                state[BEFORE_FIRST] += 1
                if not is_word_end(buf, at):
                    result = BAD_CORNER
                    break
                vertex = _resolve_index(number, n_vertices)
                if vertex < 0:
                    result = BAD_INDEX
                    break
                largest = max(largest, vertex)
                corners[n_corners] = vertex
                if len(corner_normals):
                    corner_normals[n_corners] = normal
                n_corners += 1
            size = n_corners - first_corner
            if result == WHOLE and size == 0:
                result = NO_CORNERS
            if result != WHOLE:
                state[WORD] = word
                state[BEFORE_FIRST] = before_first
                n_corners = first_corner
                at = statement
                break
            if size < 3:
                if state[SHORT] == 0:
                    state[SHORT_AT] = statement
                state[SHORT] += 1
                state[LAST_SHORT_AT] = statement
                n_corners = first_corner
            else:
                face_sizes[n_faces] = size
                n_faces += 1
                last_face = statement
            at = _skip_line(buf, at)
        elif second == 116 and is_word_end(buf, at + 2):
            state[TEXTURE] += 1
            at = _skip_line(buf, at)
        else:
            end = skip_word(buf, at)
            state[KEYWORDS] = note_keyword(buf, at, end, keywords, state[KEYWORDS])
            is_library = end - at == 6 and pack_word(buf, at, end) == MTLLIB
            if is_library and state[LIBRARIES] < len(libraries):
                libraries[state[LIBRARIES]] = statement
                state[LIBRARIES] += 1
            at = _skip_line(buf, end)
    state[AT] = at
    state[VERTICES], state[NORMALS] = n_vertices, n_normals
    state[FACES], state[CORNERS] = n_faces, n_corners
    state[UNDECIDED_ROWS] = n_undecided
    state[LARGEST_VERTEX] = largest
    state[LAST_FACE_AT] = last_face
    return result
