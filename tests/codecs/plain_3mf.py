"""3MF packages put together the plain way, independently of the codec."""

import io
import zipfile
from collections.abc import Mapping, Sequence

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
MODEL = "3D/3dmodel.model"
TYPES = (
    b'<?xml version="1.0"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/'
    b'content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-'
    b'package.relationships+xml"/><Default Extension="model" ContentType="application/'
    b'vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)


def rels(*targets: tuple[str, str]) -> bytes:
    """Relationships: target and type."""
    rows = "".join(
        f'<Relationship Target="{target}" Id="r{k}" Type="{kind}"/>'
        for k, (target, kind) in enumerate(targets)
    )
    space = "http://schemas.openxmlformats.org/package/2006/relationships"
    return f'<?xml version="1.0"?><Relationships xmlns="{space}">{rows}</Relationships>'.encode()


ROOT = rels((f"/{MODEL}", "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"))


def mesh(
    vertices: Sequence[Sequence[object]],
    faces: Sequence[Sequence[int]],
    vertex: str = '<vertex x="{0}" y="{1}" z="{2}"/>',
    triangle: str = '<triangle v1="{0}" v2="{1}" v3="{2}"/>',
) -> str:
    """A mesh with one element to a line."""
    rows = "\r\n".join(vertex.format(*row) for row in vertices)
    corners = "\n  ".join(triangle.format(*row) for row in faces)
    return f"<mesh><vertices>{rows}\n</vertices>\n<triangles>\n  {corners}</triangles></mesh>"


def shape(number: int, content: str, more: str = "") -> str:
    return f'<object id="{number}" type="model"{more}>{content}</object>'


def model(resources: str, build: str = '<item objectid="1"/>', attributes: str = "") -> bytes:
    """A model part; ``attributes`` go to its root element."""
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<!-- kept: é --><model {attributes} '
        f'xmlns="{CORE}" xmlns:p="{PRODUCTION}"><metadata name="Title">kept</metadata>'
        f"<resources>{resources}</resources>\n<build>{build}</build></model>\n"
    ).encode()


def package(
    parts: bytes | Mapping[str, bytes],
    more: Mapping[str, bytes] | None = None,
    *,
    method: int = zipfile.ZIP_DEFLATED,
    streamed: bool = False,
) -> bytes:
    """An archive of model parts and other members.

    ``streamed`` writes data descriptors behind the members, as programs do that cannot seek.
    """
    models = {MODEL: parts} if isinstance(parts, bytes) else dict(parts)
    members = {"[Content_Types].xml": TYPES, "_rels/.rels": ROOT} | models | dict(more or {})
    file = io.BytesIO()
    target = _Unseekable(file) if streamed else file
    with zipfile.ZipFile(target, "w") as archive:
        archive.comment = b"kept"
        for name, content in members.items():
            entry = zipfile.ZipInfo(name, (2021, 3, 4, 5, 6, 8))
            entry.compress_type = zipfile.ZIP_STORED if name.endswith(".png") else method
            entry.external_attr = 0o640 << 16
            entry.comment = b"of a member"
            archive.writestr(entry, content)
    return file.getvalue()


class _Unseekable(io.RawIOBase):
    def __init__(self, file: io.BytesIO) -> None:
        self._file = file

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        return self._file.write(data)
