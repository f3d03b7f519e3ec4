"""What the header of a PLY file says of the mesh: its vertices, what else it has, and warnings."""

from __future__ import annotations

from collections.abc import Sequence

from msal_cli.arrays import Ints
from msal_cli.codecs import ply_grid
from msal_cli.codecs.ply_faces import CORNERS, corner_list
from msal_cli.codecs.ply_header import NORMAL, POSITION, Element, Header, Property
from msal_cli.errors import FormatError, InputError


def wanted_names(element: Element) -> Sequence[str]:
    """Properties whose places are kept: positions, normals, corners."""
    if element.name == "vertex":
        return POSITION + NORMAL
    if element.name == "face":
        return CORNERS + NORMAL
    return CORNERS if element.name in ("tristrips", ply_grid.NAME) else ()


def has_normals(element: Element) -> bool:
    """Whether the element has nx, ny, nz as floating-point scalars."""
    found = [element.find(name) for name in NORMAL]
    return all(one is not None and not one.is_list and one.code[0] == "f" for one in found)


def vertex_element(header: Header) -> Element:
    """The element ``vertex`` with x, y and z as scalars; FormatError without."""
    vertex = header.find("vertex")
    if vertex is None:
        raise FormatError(
            "the header declares no element 'vertex'",
            where="header",
            hint="this PLY file does not hold a mesh",
        )
    for name in POSITION:
        one = vertex.find(name)
        if one is None or one.is_list:
            problem = "is a list" if one is not None else "is missing"
            raise FormatError(
                f"the coordinate '{name}' of element 'vertex' {problem}", where="header"
            )
    return vertex


def scalar_property(vertex: Element, name: str) -> Property:
    """The property ``name`` of the vertices; InputError (``E_PROPERTY``) if there is none that is
    a number."""
    one = vertex.find(name)
    if one is None or one.is_list:
        known = [each.name for each in vertex.properties if not each.is_list]
        raise InputError(
            f"the vertices have no property {name!r}"
            + (" that is a number" if one is not None else ""),
            code="E_PROPERTY",
            hint=f"they have: {', '.join(known)}",
        )
    return one


def warn_of_rest(n_behind: int) -> str:
    """What a user should know of bytes that no element has."""
    return f"{n_behind} bytes behind the last element are kept as they are"


def precision_of(header: Header, vertex: Element) -> str:
    """How the coordinates are stored, as ``codecs.mesh_file.MeshFile`` says it."""
    if header.encoding == "ascii":
        return "text"
    codes = {vertex.properties[vertex.index(name)].code for name in POSITION}
    if "f4" in codes:
        return "float32"
    return "float64" if "f8" in codes else "integer"


def properties_of(header: Header, grid: Ints | None = None) -> tuple[str, ...]:
    """What the file carries besides positions and corners, in file order; ``grid`` (rows, columns)
    is that of a range grid whose surface is read."""
    carried: list[str] = []
    for element in header.elements:
        if element.name == ply_grid.NAME and grid is not None:
            carried.append(f"range grid of {grid.shape[0]} rows and {grid.shape[1]} columns")
            continue
        if element.name not in ("vertex", "face", "tristrips"):
            carried.append(f"element {element.name} ({element.count})")
            continue
        known = POSITION if element.name == "vertex" else (corner_list(element),)
        carried += [f"{element.name}.{one}" for one in element.properties if one.name not in known]
    return tuple(carried)


def check_strays(header: Header, n_behind: int) -> None:
    """Raise FormatError for a stray line among the elements where ``n_behind`` bytes are left.

    If such a line had declared an element or a property, the data would not end where they do.
    """
    for one in header.strays:
        if one.is_doubtful and n_behind:
            raise FormatError(
                f"the header line {one.text} is not understood, and {n_behind} bytes are left "
                "behind the last element",
                where=f"line {one.line}",
                hint="make it a comment if it is one, or export the file again",
            )


def warnings_of(header: Header, vertex: Element) -> tuple[str, ...]:
    """What a user should know of the header."""
    warnings: list[str] = []
    if header.strays:
        first, count = header.strays[0], len(header.strays)
        warnings.append(
            f"{count} header {'line has' if count == 1 else 'lines have'} no known keyword and "
            f"{'is' if count == 1 else 'are'} kept like comments: {first.text} in line {first.line}"
            + (", ..." if count > 1 else "")
        )
    whole = [n for n in POSITION if vertex.properties[vertex.index(n)].code[0] != "f"]
    if whole:
        warnings.append(
            f"coordinates {', '.join(whole)} are whole numbers: new ones are rounded to the "
            "nearest, halves to the even one"
        )
    for element in header.elements:
        named = [one for one in element.properties if one.name in NORMAL]
        if element.name in ("vertex", "face") and named and not has_normals(element):
            warnings.append(
                f"the {', '.join(one.name for one in named)} of element '{element.name}' are not "
                "three floating-point numbers: they are kept, not recomputed"
            )
    return tuple(warnings)
