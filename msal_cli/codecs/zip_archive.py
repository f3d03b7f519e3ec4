"""ZIP archives whose members are replaced one by one while all other bytes stay.

The library's ``zipfile`` writes an archive anew: other times, other flags, another order.  Here
only the compressed data of a changed member, its sizes and checksum, and the offsets behind it
change.

An archive that could be read in two ways is refused: members that overlap or share a name, local
headers that contradict the central directory, archives in several files.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from msal_cli.errors import (
    CUT_SHORT,
    FormatError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.regular import Buffer

_LOCAL, _CENTRAL, _END = b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"
_END_64, _LOCATOR_64, _DESCRIPTOR = b"PK\x06\x06", b"PK\x06\x07", b"PK\x07\x08"
_END_SIZE, _LOCATOR_SIZE = 22, 20
_MAX_COMMENT = 0xFFFF
_SEE_EXTRA = 0xFFFFFFFF
"""In place of a size or an offset that is in the ZIP64 field."""

_LEVEL = 5
"""Of deflate: on a million faces 0.4 % larger than level 6, in 0.6 of its time."""

_IS_ENCRYPTED, _HAS_DESCRIPTOR, _IS_UTF8 = 1, 8, 1 << 11
_STORED, _DEFLATED = 0, 8

_NEWEST_VERSION = 63
"""Of the zip format, in tenths, that other readers know, too."""

_DAMAGED = "the archive is damaged; copy or export it again"
_REPACK = "pack it again as a plain zip archive"


@dataclass(frozen=True)
class _Header:
    """Offsets inside a kind of header: its ``size``, the lengths of its name and of its extra field
    (two 16-bit numbers), its checksum, and those numbers that ZIP64 may move to the extra field."""

    size: int
    lengths: int
    crc: int
    numbers: dict[str, int]


_ENTRY = _Header(46, 28, 16, {"size": 24, "packed": 20, "offset": 42})
"""An entry of the central directory."""

_LOCAL_HEADER = _Header(30, 26, 14, {"size": 22, "packed": 18})

_Places = dict[str, tuple[int, str]]
"""The first byte of each number of a header, and its type for ``struct``."""

_Numbers = dict[str, int]
"""``crc``, ``packed`` and ``size`` of a member, and ``offset``, the first byte of its header."""


@dataclass(frozen=True, slots=True)
class Member:
    """A file in an archive.

    Attributes
    ----------
    header_at, data_at : first bytes of the local header and of the compressed data.
    entry_at : first byte of its entry in the central directory.
    name : as the directory has it, with slashes.
    flags, method, crc, packed_size, size : as the central directory has them.
    stop : first byte of the next member's header, or of the central directory.
    """

    header_at: int
    data_at: int
    entry_at: int
    name: str
    flags: int
    method: int
    crc: int
    packed_size: int
    size: int
    stop: int

    @property
    def numbers(self) -> _Numbers:
        return {"crc": self.crc, "packed": self.packed_size, "size": self.size}


class Archive:
    """An archive taken apart."""

    def __init__(self, data: Buffer) -> None:
        self.data = memoryview(data).cast("B")
        self._end_at = _find_end(self.data)
        self._central_at, self._central_size, self._count = self._read_end()
        self.members = self._read_members()
        self._by_key = {_key(member.name): member for member in self.members}
        if len(self._by_key) < len(self.members):
            raise FormatError("two members have one name", where="central directory", hint=_DAMAGED)

    def find(self, name: str) -> Member | None:
        """The member of that name, a leading slash and the case of letters disregarded."""
        return self._by_key.get(_key(name))

    def _read_end(self) -> tuple[int, int, int]:
        """Offset, size and number of entries of the central directory."""
        disk, first_disk, here, count, size, at = struct.unpack_from(
            "<4H2L", self.data, self._end_at + 4
        )
        self._end_64_at = -1
        disks = 1
        locator_at = self._end_at - _LOCATOR_SIZE
        if locator_at >= 0 and self.data[locator_at : locator_at + 4] == _LOCATOR_64:
            end_64_at, disks = struct.unpack_from("<QL", self.data, locator_at + 8)
            is_there = end_64_at + 56 == locator_at and self.data[end_64_at:][:4] == _END_64
            if disks <= 1 and not is_there:
                raise FormatError(
                    "the archive has no end record where it is said to lie", hint=_DAMAGED
                )
            if is_there:
                disk, first_disk, here, count, size, at = struct.unpack_from(
                    "<LLQQQQ", self.data, end_64_at + 16
                )
                self._end_64_at = end_64_at
        if disks > 1 or disk or first_disk or here != count:
            raise UnsupportedError("the archive is split into several files", hint=_REPACK)
        if at + size != (self._end_at if self._end_64_at < 0 else self._end_64_at):
            raise _damaged("the central directory does not end where it should", at)
        return at, size, count

    def _read_members(self) -> tuple[Member, ...]:
        """All members in the order of their bytes."""
        entries = []
        at, stop = self._central_at, self._central_at + self._central_size
        while at < stop:
            if at + _ENTRY.size > stop or self.data[at : at + 4] != _CENTRAL:
                raise _damaged("an entry of the central directory is damaged", at)
            version, flags, method = struct.unpack_from("<3H", self.data, at + 6)
            name_size, extra_size, comment_size, disk = struct.unpack_from(
                "<4H", self.data, at + _ENTRY.lengths
            )
            raw_name = bytes(self.data[at + _ENTRY.size :][:name_size])
            name = raw_name.decode("utf-8" if flags & _IS_UTF8 else "cp437", "replace")
            if version & 0xFF > _NEWEST_VERSION:
                raise UnsupportedError(
                    f"{name} needs version {(version & 0xFF) / 10:.1f} of the zip format",
                    where=f"byte {at}",
                    hint=_REPACK,
                )
            if disk not in (0, 0xFFFF):
                raise UnsupportedError("the archive is split into several files", hint=_REPACK)
            numbers = self._read(_ENTRY, at)
            header_at = numbers["offset"]
            data_at = self._read_local(header_at, raw_name, name)
            sizes = numbers["crc"], numbers["packed"], numbers["size"]
            entries.append((header_at, data_at, at, name, flags, method, *sizes))
            at += _ENTRY.size + name_size + extra_size + comment_size
        if at != stop or len(entries) != self._count:
            raise _damaged(
                f"the central directory has {len(entries)} entries, not {self._count}",
                self._central_at,
            )
        entries.sort()
        stops = [*(entry[0] for entry in entries[1:]), self._central_at]
        members = tuple(Member(*entry, end) for entry, end in zip(entries, stops, strict=False))
        for member in members:
            if member.data_at + member.packed_size > member.stop:
                raise _damaged(f"{member.name} reaches into what follows it", member.header_at)
        return members

    def _read_local(self, at: int, raw_name: bytes, name: str) -> int:
        """The first byte of a member's data, behind the local header at ``at``."""
        begin = at + _LOCAL_HEADER.size
        if begin > self._central_at or self.data[at : at + 4] != _LOCAL:
            raise _damaged(f"{name} has no local header", at)
        name_size, extra_size = struct.unpack_from("<2H", self.data, at + _LOCAL_HEADER.lengths)
        if self.data[begin : begin + name_size] != raw_name:
            raise _damaged(f"{name} has another name in its local header", at)
        return int(begin + name_size + extra_size)

    def _places(self, header: _Header, at: int) -> _Places:
        """Where the numbers of the header at ``at`` lie, in it or in its ZIP64 field."""
        places = {word: (at + offset, "<L") for word, offset in header.numbers.items()}
        wide = [w for w, place in places.items() if self._value(place) == _SEE_EXTRA]
        name_size, extra_size = struct.unpack_from("<2H", self.data, at + header.lengths)
        field_at = at + header.size + name_size
        stop = min(field_at + extra_size, len(self.data))
        while wide and field_at + 4 <= stop:
            kind, length = struct.unpack_from("<2H", self.data, field_at)
            field_at += 4
            if kind == 1:
                ends = range(field_at + 8, min(field_at + length, stop) + 1, 8)
                places |= {w: (end - 8, "<Q") for w, end in zip(wide, ends, strict=False)}
                break
            field_at += length
        return places | {"crc": (at + header.crc, "<L")}

    def _value(self, place: tuple[int, str]) -> int:
        return int(struct.unpack_from(place[1], self.data, place[0])[0])

    def _read(self, header: _Header, at: int) -> _Numbers:
        return {word: self._value(place) for word, place in self._places(header, at).items()}

    def content(self, member: Member, room: int) -> bytes:
        """The expanded content of a member, of at most ``room`` bytes.

        Nothing beyond the size in the directory is ever expanded.
        """
        if member.flags & _IS_ENCRYPTED:
            raise UnsupportedError(
                f"{member.name} is encrypted", hint="export it without a password"
            )
        if member.size > room:
            raise TooLargeError(
                f"it expands to {member.size:,} bytes, and there is room for {room:,}",
                where=member.name,
                hint="no mesh compresses so well; if you trust it, pack it without compression",
            )
        is_in_header = not member.flags & _HAS_DESCRIPTOR
        if is_in_header and self._read(_LOCAL_HEADER, member.header_at) != member.numbers:
            raise _damaged(f"{member.name} has other sizes in its local header", member.header_at)
        packed = self.packed(member)
        if member.method == _STORED:
            content = bytes(packed)
        elif member.method == _DEFLATED:
            content = _inflate(packed, member)
        else:
            raise UnsupportedError(
                f"{member.name} is compressed by method {member.method}", hint=_REPACK
            )
        if len(content) != member.size or zlib.crc32(content) != member.crc:
            raise FormatError(
                "it has another size or checksum than it should",
                where=member.name,
                hint=_DAMAGED,
            )
        return content

    def packed(self, member: Member) -> memoryview:
        """The data of a member as they are stored."""
        return self.data[member.data_at : member.data_at + member.packed_size]

    def replace(self, contents: Mapping[str, Buffer]) -> bytes:
        """The archive with new contents for the members of these names; all else is kept."""
        new = {}
        for name, content in contents.items():
            packed = content
            if self._by_key[_key(name)].method == _DEFLATED:
                deflate = zlib.compressobj(_LEVEL, zlib.DEFLATED, -15)
                packed = deflate.compress(content) + deflate.flush()
            numbers = {"crc": zlib.crc32(content), "packed": len(packed), "size": len(content)}
            new[name] = packed, numbers
        return self.assemble(new)

    def assemble(self, contents: Mapping[str, tuple[Buffer, _Numbers]]) -> bytes:
        """The archive with new data, as they are stored, and new numbers of some members."""
        pieces: list[Buffer] = []
        size = done = 0
        tail = bytearray(self.data[self._central_at :])
        for member in self.members:
            pieces.append(self.data[done : member.header_at])
            size += member.header_at - done
            new = {"offset": size}
            if member.name in contents:
                own = self._wrap(member, *contents[member.name])
                new |= contents[member.name][1]
            else:
                own = [self.data[member.header_at : member.stop]]
            pieces += own
            size += sum(map(len, own))
            done = member.stop
            _write(tail, self._places(_ENTRY, member.entry_at), new, self._central_at)
        pieces.append(self.data[done : self._central_at])
        if size > _SEE_EXTRA - (1 << 24) and self._end_64_at < 0:
            raise TooLargeError(
                "the archive would have more than 4 GB", hint="cut the mesh into parts"
            )
        self._move_end(tail, size - done)
        return b"".join([*pieces, tail])

    def _wrap(self, member: Member, packed: Buffer, new: _Numbers) -> list[Buffer]:
        """New data of a member between its header and what follows, with new numbers in both."""
        head = bytearray(self.data[member.header_at : member.data_at])
        tail = bytearray(self.data[member.data_at + member.packed_size : member.stop])
        # With a descriptor the header need not have them, but some programs write them twice.
        places = self._places(_LOCAL_HEADER, member.header_at)
        if self._read(_LOCAL_HEADER, member.header_at) == member.numbers:
            _write(head, places, new, member.header_at)
        if member.flags & _HAS_DESCRIPTOR:
            _write_descriptor(tail, member, new)
        return [head, packed, tail]

    def _move_end(self, tail: bytearray, shift: int) -> None:
        """Move the directory's offset in the end records of ``tail`` by ``shift``."""
        new = self._central_at + shift
        end_at = self._end_at - self._central_at
        if struct.unpack_from("<L", tail, end_at + 16)[0] != _SEE_EXTRA:
            struct.pack_into("<L", tail, end_at + 16, new)
        if self._end_64_at >= 0:
            struct.pack_into("<Q", tail, self._end_64_at - self._central_at + 48, new)
            struct.pack_into("<Q", tail, end_at - _LOCATOR_SIZE + 8, self._end_64_at + shift)


def _damaged(message: str, at: int) -> FormatError:
    return FormatError(message, where=f"byte {at}", hint=_DAMAGED)


def _key(name: str) -> str:
    return name.lstrip("/").lower()


def _find_end(data: memoryview) -> int:
    """The first byte of the end record, whose comment reaches to the end of the file."""
    if data[:4] not in (_LOCAL, _END):
        raise _damaged("the file is not a zip archive", 0)
    first = max(0, len(data) - _END_SIZE - _MAX_COMMENT)
    tail = bytes(data[first:])
    at = len(tail)
    while (at := tail.rfind(_END, 0, at)) >= 0:
        if at + _END_SIZE <= len(tail):
            (length,) = struct.unpack_from("<H", tail, at + 20)
            if at + _END_SIZE + length == len(tail):
                return first + at
    raise TruncatedError(
        "the archive has no end record",
        where=f"byte {len(data)}",
        hint=CUT_SHORT,
    )


def _inflate(packed: memoryview, member: Member) -> bytes:
    inflate = zlib.decompressobj(-15)
    try:
        content = inflate.decompress(packed, member.size + 1)
    except zlib.error as failure:
        raise FormatError(
            f"{member.name} cannot be expanded ({failure})", where=member.name, hint=_DAMAGED
        ) from failure
    if len(content) == member.size and not inflate.eof:
        # Its end mark may be all that is left.
        content += inflate.decompress(inflate.unconsumed_tail, 1)
    return content


def _write(target: bytearray, places: _Places, numbers: _Numbers, begin: int) -> None:
    """Write numbers to their places in ``target``, the bytes of the archive from ``begin`` on."""
    for word, value in numbers.items():
        at, code = places[word]
        if code == "<L" and value >= _SEE_EXTRA and word != "crc":
            raise TooLargeError(
                "a member would have more than 4 GB", hint="cut the mesh into parts"
            )
        struct.pack_into(code, target, at - begin, value)


def _write_descriptor(tail: bytearray, member: Member, new: _Numbers) -> None:
    """Put new numbers into the data descriptor at the beginning of ``tail``, in its own form."""
    for head in (_DESCRIPTOR, b""):
        for form in ("<LQQ", "<LLL"):
            old = head + struct.pack(form, *member.numbers.values())
            if tail[: len(old)] == old:
                tail[: len(old)] = head + struct.pack(form, *new.values())
                return
    raise _damaged(f"{member.name} has no data descriptor", member.data_at + member.packed_size)
