"""A new 3MF file of one mesh: one object, one item of the build, unit millimetre."""

from __future__ import annotations

import io
import zipfile

import numpy as np

from msal_cli.arrays import Floats, Ints

_TYPES = b"""<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONSHIPS = b"""<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
_HEAD = b"""<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" \
xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
<resources>
<object id="1" type="model">
<mesh>
<vertices>
"""
_MIDDLE = b"</vertices>\n<triangles>\n"
_TAIL = b"""</triangles>
</mesh>
</object>
</resources>
<build>
<item objectid="1"/>
</build>
</model>
"""
_EARLIEST = (1980, 1, 1, 0, 0, 0)
_UNIX = 3


def to_3mf(vertices: Floats, faces: Ints, *, single: bool) -> bytes:
    """A 3MF file of vertices (n, 3) and triangles (m, 3); the same bytes on every run.

    Each number is the shortest text that is read back as the same float64, or float32.
    """
    from msal_cli.kernels import text
    from msal_cli.kernels.text_rows import fill_rows

    digits, stops = text.printed_shortest(vertices.reshape(-1), single)
    rows = fill_rows((b'<vertex x="', b'" y="', b'" z="', b'"/>\n'), digits, stops)
    digits, stops = text.printed(faces.reshape(-1).astype(np.float64), 0)
    triangles = fill_rows((b'<triangle v1="', b'" v2="', b'" v3="', b'"/>\n'), digits, stops)
    model = b"".join([_HEAD, *rows, _MIDDLE, *triangles, _TAIL])
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in (
            ("[Content_Types].xml", _TYPES),
            ("_rels/.rels", _RELATIONSHIPS),
            ("3D/3dmodel.model", model),
        ):
            entry = zipfile.ZipInfo(name, _EARLIEST)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = _UNIX
            archive.writestr(entry, content)
    return file.getvalue()
