"""ZIP archives whose members are replaced one by one while all other bytes stay.

``zipfile`` can read an archive, but would rewrite it with other times, other flags and another
order.  Here only the compressed data of a changed member, its sizes and checksum, and the offsets
after it change.

Ambiguous archives are refused: those with members that overlap, share a name, or have another name
in their local header.
"""

import contextlib
import io
import itertools
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from zipfile import ZipInfo

from msal_cli import errors
from msal_cli.storage.regular import Buffer

_LOCAL, _END, _END_64, _DESCRIPTOR = b"PK\x03\x04", b"PK\x05\x06", b"PK\x06\x06", b"PK\x07\x08"
_LOCAL_SIZE, _ENTRY_SIZE, _END_SIZE, _LOCATOR_SIZE = 30, 46, 22, 20
_SEE_EXTRA = 0xFFFFFFFF  # this value of a size or an offset means that it is in the ZIP64 field
_LEVEL = 5  # compression level: for a million faces 0.4 % larger than level 6, in 0.6 of its time

_IS_ENCRYPTED, _HAS_DESCRIPTOR = 1, 8
_REPACK = "pack it again as a plain zip archive"

_Places = dict[str, tuple[int, str]]
"""The first byte of each number in a header, and its type for ``struct``."""

Numbers = dict[str, int]  # the ``crc``, ``packed`` and ``size`` of a member


class Archive:
    def __init__(self, data: Buffer) -> None:
        self._data = memoryview(data).cast("B")
        file = io.BytesIO(data)
        if self._data[:4] not in (_LOCAL, _END):
            raise errors.other_format("the file is not a zip archive", "byte 0", "3mf")
        if not zipfile.is_zipfile(file):
            where = f"byte {len(self._data)}"
            raise errors.cut_short("the archive has no end record", where)
        with _errors("central directory"):
            self._zip = zipfile.ZipFile(file)
        self._central_at = self._zip.start_dir
        self._entries: dict[str, int] = {}
        at = self._central_at
        for member in self._zip.infolist():
            self._entries[_key(member.filename)] = at
            at += _ENTRY_SIZE + sum(struct.unpack_from("<3H", self._data, at + 28))
        self._entries_end = at
        self._end_at = self._find_end(at)
        self._members = {_key(member.filename): member for member in self._zip.infolist()}
        if len(self._members) < len(self._zip.infolist()):
            raise errors.damaged("two members have one name", "central directory")
        # In the order of the file: each member ends where the next one begins.
        ordered = sorted(self._members.values(), key=lambda member: member.header_offset)
        self._stops: dict[str, int] = {}
        starts = [member.header_offset for member in ordered[1:]]
        for member, stop in zip(ordered, [*starts, self._central_at], strict=False):
            self._stops[member.filename] = stop
            if self._data_at(member) + member.compress_size > stop:
                raise errors.damaged(
                    f"{member.filename} reaches into what follows it",
                    f"byte {member.header_offset}",
                )
        self._ordered = ordered

    def _find_end(self, at: int) -> int:
        """The first byte of the end record, which is at ``at`` or after the ZIP64 records there."""
        if self._data[at : at + 4] == _END_64:
            at += 12 + self._value((at + 4, "<Q")) + _LOCATOR_SIZE
        if self._data[at : at + 4] != _END or at + _END_SIZE > len(self._data):
            raise errors.damaged("no end record follows the directory", f"byte {at}")
        disk, first_disk, here, count = struct.unpack_from("<4H", self._data, at + 4)
        if at == self._entries_end and (disk or first_disk or here != count):
            raise errors.UnsupportedError("the archive is split into several files", hint=_REPACK)
        end = at + _END_SIZE + struct.unpack_from("<H", self._data, at + 20)[0]
        if end > len(self._data):
            raise errors.cut_short("the comment of the archive is cut", f"byte {len(self._data)}")
        if end < len(self._data):
            raise errors.damaged("other bytes follow the end of the archive", f"byte {end}")
        return at

    def find(self, name: str) -> ZipInfo | None:
        """The member of that name, ignoring a leading slash and case."""
        return self._members.get(_key(name))

    def content(self, member: ZipInfo, room: int) -> bytes:
        """The expanded content of a member, of at most ``room`` bytes.

        No more than the size in the directory is expanded.
        """
        if member.flag_bits & _IS_ENCRYPTED:
            raise errors.UnsupportedError(
                f"{member.filename} is encrypted", hint="export it without a password"
            )
        if member.file_size > room:
            raise errors.TooLargeError(
                f"it expands to {member.file_size:,} bytes, and there is room for {room:,}",
                where=member.filename,
                hint="no mesh compresses so well; if you trust it, pack it without compression",
            )
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise errors.UnsupportedError(
                f"{member.filename} is compressed by method {member.compress_type}", hint=_REPACK
            )
        places, numbers = self._places(member.header_offset), numbers_of(member)
        is_in_header = not member.flag_bits & _HAS_DESCRIPTOR
        if is_in_header and any(self._value(places[word]) != numbers[word] for word in numbers):
            raise errors.damaged(
                f"{member.filename} has other sizes in its local header",
                f"byte {member.header_offset}",
            )
        # Without a limit all compressed data would be expanded before they are counted.
        with _errors(member.filename), self._zip.open(member) as file:
            content = file.read(member.file_size + 1)
        if len(content) != member.file_size:
            raise errors.damaged("it has another size than it should", member.filename)
        return content

    def packed(self, member: ZipInfo) -> memoryview:
        """The data of a member as they are stored."""
        at = self._data_at(member)
        return self._data[at : at + member.compress_size]

    def replace(self, contents: Mapping[str, Buffer]) -> bytes:
        """The archive with new contents for the members of these names; all else is kept."""
        new = {}
        for name, content in contents.items():
            packed = content
            if self._members[_key(name)].compress_type == zipfile.ZIP_DEFLATED:
                deflate = zlib.compressobj(_LEVEL, zlib.DEFLATED, -15)
                packed = deflate.compress(content) + deflate.flush()
            numbers = {"crc": zlib.crc32(content), "packed": len(packed), "size": len(content)}
            new[name] = packed, numbers
        return self.assemble(new)

    def assemble(self, contents: Mapping[str, tuple[Buffer, Numbers]]) -> bytes:
        """The archive with new stored data, and new numbers, of some members."""
        pieces: list[Buffer] = []
        shift = done = 0
        tail = bytearray(self._data[self._central_at :])
        for member in self._ordered:
            entry_at, stop = self._entries[_key(member.filename)], self._stops[member.filename]
            places = self._places(entry_at, 42)
            new = {"offset": self._value(places["offset"]) + shift}
            if member.filename in contents:
                packed, numbers = contents[member.filename]
                own = self._wrap(member, packed, numbers, stop)
                pieces += [self._data[done : member.header_offset], *own]
                done = stop
                shift += sum(map(len, own)) - (stop - member.header_offset)
                new |= numbers
            _write(tail, places, new, self._central_at)
        pieces.append(self._data[done : self._central_at])
        if self._central_at + shift > _SEE_EXTRA - (1 << 24):
            raise errors.TooLargeError(
                "the archive would have more than 4 GB", hint="cut the mesh into parts"
            )
        # Shift the offset of the directory in the end records.
        at, end_at = (k - self._central_at for k in (self._entries_end, self._end_at))
        ends = [(at + 48, "<Q"), (end_at - _LOCATOR_SIZE + 8, "<Q")] if at < end_at else []
        if struct.unpack_from("<L", tail, end_at + 16)[0] != _SEE_EXTRA:
            ends.append((end_at + 16, "<L"))
        for place, code in ends:
            struct.pack_into(code, tail, place, struct.unpack_from(code, tail, place)[0] + shift)
        return b"".join([*pieces, tail])

    def _data_at(self, member: ZipInfo) -> int:
        at = member.header_offset
        if at + _LOCAL_SIZE > self._central_at or self._data[at : at + 4] != _LOCAL:
            raise errors.damaged(f"{member.filename} has no local header", f"byte {at}")
        return int(at + _LOCAL_SIZE + sum(struct.unpack_from("<2H", self._data, at + 26)))

    def _places(self, at: int, offset: int = 0) -> _Places:
        """The places of the numbers in the local header at ``at`` or, with ``offset``, in the entry
        of the directory there: in it or in its ZIP64 field."""
        begin, size = (16, _ENTRY_SIZE) if offset else (14, _LOCAL_SIZE)
        places = {"size": (at + begin + 8, "<L"), "packed": (at + begin + 4, "<L")}
        if offset:
            places["offset"] = at + offset, "<L"
        wide = [word for word, place in places.items() if self._value(place) == _SEE_EXTRA]
        name_size, extra_size = struct.unpack_from("<2H", self._data, at + begin + 12)
        field_at = at + size + name_size
        stop = field_at + extra_size
        while wide and field_at + 4 <= stop:
            kind, length = struct.unpack_from("<2H", self._data, field_at)
            field_at += 4
            if kind == 1:
                firsts = range(field_at, min(field_at + length, stop) - 7, 8)
                places |= {w: (first, "<Q") for w, first in zip(wide, firsts, strict=False)}
                break
            field_at += length
        return places | {"crc": (at + begin, "<L")}

    def _value(self, place: tuple[int, str]) -> int:
        return int(struct.unpack_from(place[1], self._data, place[0])[0])

    def _wrap(self, member: ZipInfo, packed: Buffer, new: Numbers, stop: int) -> list[Buffer]:
        """A member with new data and numbers: its header, the data, and what follows."""
        begin, data_at = member.header_offset, self._data_at(member)
        head = bytearray(self._data[begin:data_at])
        tail = bytearray(self._data[data_at + member.compress_size : stop])
        # With a descriptor the header need not contain them, but some programs write both.
        places, old = self._places(begin), numbers_of(member)
        if {word: self._value(places[word]) for word in old} == old:
            _write(head, places, new, begin)
        if member.flag_bits & _HAS_DESCRIPTOR:
            for start, form in itertools.product((_DESCRIPTOR, b""), ("<LQQ", "<LLL")):
                if tail.startswith(before := start + struct.pack(form, *old.values())):
                    tail[: len(before)] = start + struct.pack(form, *new.values())
                    break
            else:
                where = f"byte {data_at + member.compress_size}"
                raise errors.FormatError(f"{member.filename} has no data descriptor", where=where)
        return [head, packed, tail]


def numbers_of(member: ZipInfo) -> Numbers:
    """The numbers of a member in the directory."""
    return {"crc": member.CRC, "packed": member.compress_size, "size": member.file_size}


@contextlib.contextmanager
def _errors(where: str) -> Iterator[None]:
    """Convert errors of ``zipfile`` to FormatError or UnsupportedError."""
    try:
        yield
    except NotImplementedError as failure:
        raise errors.UnsupportedError(
            f"the archive cannot be read: {failure}", hint=_REPACK
        ) from None
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, struct.error):
        message = "the archive contradicts itself, or a checksum is wrong"
        raise errors.damaged(message, where) from None


def _key(name: str) -> str:
    return name.lstrip("/").lower()


def _write(target: bytearray, places: _Places, numbers: Numbers, begin: int) -> None:
    """Write numbers to their places; ``target`` are the bytes of the archive from ``begin`` on."""
    for word, value in numbers.items():
        at, code = places[word]
        if code == "<L" and value >= _SEE_EXTRA and word != "crc":
            raise errors.TooLargeError(
                "a member would have more than 4 GB", hint="cut the mesh into parts"
            )
        struct.pack_into(code, target, at - begin, value)
