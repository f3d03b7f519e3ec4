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

from msal_cli.errors import FormatError, TooLargeError, TruncatedError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_LOCAL, _CENTRAL, _END = b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"
_END_64, _LOCATOR_64, _DESCRIPTOR = b"PK\x06\x06", b"PK\x06\x07", b"PK\x07\x08"
_LOCAL_FORM, _CENTRAL_FORM, _END_FORM = "<4s5H3L2H", "<4s6H3L5H2L", "<4s4H2LH"
_LOCAL_SIZE, _CENTRAL_SIZE, _END_SIZE, _LOCATOR_SIZE = 30, 46, 22, 20
_LONGEST_COMMENT = 0xFFFF
_SEE_EXTRA = 0xFFFFFFFF
"""Stands in place of a size or an offset that is in the ZIP64 field."""

_LEVEL = 5
"""Of deflate: on a million faces 0.4 % larger than level 6, in 0.6 of its time."""

_IS_ENCRYPTED, _HAS_DESCRIPTOR, _IS_UTF8 = 1, 8, 1 << 11
_STORED, _DEFLATED = 0, 8

_NEWEST_VERSION = 63
"""Of the zip format, in tenths, that other readers know, too."""

_DAMAGED = "the archive is damaged; copy or export it again"
_REPACK = "pack it again as a plain zip archive"


@dataclass(frozen=True, slots=True)
class Member:
    """A file in an archive.

    Attributes
    ----------
    name : as the directory has it, with slashes.
    flags, method, crc, packed_size, size : as the central directory has them.
    header_at, data_at : first bytes of the local header and of the compressed data.
    stop : first byte of the next member's header, or of the central directory.
    entry_at : first byte of its entry in the central directory.
    """

    name: str
    flags: int
    method: int
    crc: int
    packed_size: int
    size: int
    header_at: int
    data_at: int
    stop: int
    entry_at: int


class Archive:
    """An archive taken apart.

    Raises
    ------
    FormatError, TruncatedError, UnsupportedError
    """

    def __init__(self, data: Buffer) -> None:
        self.data = memoryview(data).cast("B")
        self._end_at = _find_end(self.data)
        self._central_at, self._central_size, self._count = self._directory()
        self.members = self._members()
        self._by_key = {_key(member.name): member for member in self.members}
        if len(self._by_key) < len(self.members):
            raise FormatError("two members have one name", where="central directory", hint=_DAMAGED)

    def find(self, name: str) -> Member | None:
        """The member of that name, a leading slash and the case of letters disregarded."""
        return self._by_key.get(_key(name))

    def _directory(self) -> tuple[int, int, int]:
        """Offset, size and number of entries of the central directory."""
        (_, disk, first_disk, here, count, size, at, _) = struct.unpack_from(
            _END_FORM, self.data, self._end_at
        )
        self._end_64_at = -1
        locator_at = self._end_at - _LOCATOR_SIZE
        if locator_at >= 0 and self.data[locator_at : locator_at + 4] == _LOCATOR_64:
            _, _, end_64_at, disks = struct.unpack_from("<4sLQL", self.data, locator_at)
            if disks > 1:
                raise UnsupportedError("the archive is split into several files", hint=_REPACK)
            if end_64_at + 56 != locator_at or self.data[end_64_at : end_64_at + 4] != _END_64:
                raise FormatError(
                    "the archive has no end record where it is said to lie", hint=_DAMAGED
                )
            disk, first_disk, here, count, size, at = struct.unpack_from(
                "<LLQQQQ", self.data, end_64_at + 16
            )
            self._end_64_at = end_64_at
        if disk or first_disk or here != count:
            raise UnsupportedError("the archive is split into several files", hint=_REPACK)
        if at + size != (self._end_at if self._end_64_at < 0 else self._end_64_at):
            raise FormatError(
                "the central directory does not end where it should",
                where=f"byte {at}",
                hint=_DAMAGED,
            )
        return at, size, count

    def _members(self) -> tuple[Member, ...]:
        """All members in the order of their bytes."""
        found = []
        at, stop = self._central_at, self._central_at + self._central_size
        while at < stop:
            if at + _CENTRAL_SIZE > stop or self.data[at : at + 4] != _CENTRAL:
                raise FormatError(
                    "an entry of the central directory is damaged",
                    where=f"byte {at}",
                    hint=_DAMAGED,
                )
            entry = struct.unpack_from(_CENTRAL_FORM, self.data, at)
            flags, method, crc = entry[3], entry[4], entry[7]
            name_size, extra_size, comment_size, disk = entry[10:14]
            raw = bytes(self.data[at + _CENTRAL_SIZE : at + _CENTRAL_SIZE + name_size])
            name = raw.decode("utf-8" if flags & _IS_UTF8 else "cp437", "replace")
            length = _CENTRAL_SIZE + name_size + extra_size + comment_size
            values = {
                word: self._value(at + place, wide)
                for word, (place, wide) in self._central_places(at).items()
            }
            if entry[2] & 0xFF > _NEWEST_VERSION:
                raise UnsupportedError(
                    f"{name} needs version {(entry[2] & 0xFF) / 10:.1f} of the zip format",
                    where=f"byte {at}",
                    hint=_REPACK,
                )
            if disk not in (0, 0xFFFF):
                raise UnsupportedError("the archive is split into several files", hint=_REPACK)
            header_at = values["offset"]
            data_at = self._local(header_at, raw, name)
            found.append(
                (header_at, data_at, at, name, flags, method, crc, values["packed"], values["size"])
            )
            at += length
        if at != stop or len(found) != self._count:
            raise FormatError(
                f"the central directory has {len(found)} entries, not {self._count}",
                where=f"byte {self._central_at}",
                hint=_DAMAGED,
            )
        found.sort()
        stops = [*(one[0] for one in found[1:]), self._central_at][: len(found)]
        members = []
        for one, end in zip(found, stops, strict=True):
            header_at, data_at, entry_at, name, flags, method, crc, packed, size = one
            if data_at + packed > end:
                raise FormatError(
                    f"{name} reaches into what follows it", where=f"byte {header_at}", hint=_DAMAGED
                )
            members.append(
                Member(name, flags, method, crc, packed, size, header_at, data_at, end, entry_at)
            )
        return tuple(members)

    def _local(self, at: int, raw_name: bytes, name: str) -> int:
        """The first byte of a member's data, behind the local header at ``at``."""
        if at + _LOCAL_SIZE > self._central_at or self.data[at : at + 4] != _LOCAL:
            raise FormatError(f"{name} has no local header", where=f"byte {at}", hint=_DAMAGED)
        name_size, extra_size = struct.unpack_from("<2H", self.data, at + 26)
        begin = at + _LOCAL_SIZE
        if bytes(self.data[begin : begin + name_size]) != raw_name:
            raise FormatError(
                f"{name} has another name in its local header", where=f"byte {at}", hint=_DAMAGED
            )
        return int(begin + name_size + extra_size)

    def _value(self, at: int, wide: bool) -> int:
        return int(struct.unpack_from("<Q" if wide else "<L", self.data, at)[0])

    def _central_places(self, at: int) -> dict[str, tuple[int, bool]]:
        """Where sizes and offset of a directory entry lie behind ``at``, and if 64 bits wide."""
        entry = struct.unpack_from(_CENTRAL_FORM, self.data, at)
        extra_at = _CENTRAL_SIZE + entry[10]
        places = {"size": (24, False), "packed": (20, False), "offset": (42, False)}
        return self._widened(at, places, extra_at, entry[11])

    def _local_places(self, at: int) -> dict[str, tuple[int, bool]]:
        """The same for the sizes of a local header."""
        name_size, extra_size = struct.unpack_from("<2H", self.data, at + 26)
        places = {"size": (22, False), "packed": (18, False)}
        return self._widened(at, places, _LOCAL_SIZE + name_size, extra_size)

    def _widened(
        self, at: int, places: dict[str, tuple[int, bool]], extra_at: int, extra_size: int
    ) -> dict[str, tuple[int, bool]]:
        """``places`` with those values that stand in the ZIP64 field there."""
        wanted = [
            w for w, (place, _) in places.items() if self._value(at + place, False) == _SEE_EXTRA
        ]
        here, stop = at + extra_at, at + extra_at + extra_size
        while wanted and here + 4 <= min(stop, len(self.data)):
            kind, length = struct.unpack_from("<2H", self.data, here)
            if kind == 1:
                place = here + 4
                for word in wanted:
                    if place + 8 > min(here + 4 + length, stop, len(self.data)):
                        break
                    places[word] = (place - at, True)
                    place += 8
                break
            here += 4 + length
        return places

    def _local_numbers(self, member: Member) -> tuple[int, int, int]:
        """Checksum, packed size and size as the local header has them."""
        at = member.header_at
        places = self._local_places(at)
        packed, size = (self._value(at + places[w][0], places[w][1]) for w in ("packed", "size"))
        return self._value(at + 14, False), packed, size

    def content(self, member: Member, room: int) -> bytes:
        """The expanded content of a member, of at most ``room`` bytes.

        Raises
        ------
        FormatError
            if it is damaged, or has another size or checksum than the directory says.
        TooLargeError
            if it is larger; nothing beyond the size in the directory is ever expanded.
        UnsupportedError
            if it is encrypted or compressed in another way than by deflate.
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
        if not member.flags & _HAS_DESCRIPTOR and self._local_numbers(member) != _numbers(member):
            raise FormatError(
                f"{member.name} has other sizes in its local header",
                where=f"byte {member.header_at}",
                hint=_DAMAGED,
            )
        packed = self.data[member.data_at : member.data_at + member.packed_size]
        if member.method == _STORED:
            content = bytes(packed)
        elif member.method == _DEFLATED:
            content = _inflated(packed, member)
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

    def rewritten(self, contents: Mapping[str, Buffer]) -> bytes:
        """The archive with new contents for the members of these names; all else is kept."""
        pieces: list[Buffer] = []
        size = 0
        moved: dict[int, int] = {}
        news: dict[int, tuple[int, int, int]] = {}
        done = 0
        for member in self.members:
            pieces.append(self.data[done : member.header_at])
            size += member.header_at - done
            moved[member.entry_at] = size
            done = member.stop
            if member.name in contents:
                new, numbers = self._packed(member, contents[member.name])
                news[member.entry_at] = numbers
            else:
                new = [self.data[member.header_at : member.stop]]
            pieces += new
            size += sum(map(len, new))
        pieces.append(self.data[done : self._central_at])
        shift = size + self._central_at - done - self._central_at
        if size > _SEE_EXTRA - (1 << 24) and self._end_64_at < 0:
            raise TooLargeError(
                "the archive would have more than 4 GB", hint="cut the mesh into parts"
            )
        rest = bytearray(self.data[self._central_at :])
        for member in self.members:
            self._set_entry(
                rest, member.entry_at, moved[member.entry_at], news.get(member.entry_at)
            )
        self._set_end(rest, shift)
        return b"".join([*pieces, rest])

    def _packed(self, member: Member, content: Buffer) -> tuple[list[Buffer], tuple[int, int, int]]:
        """A member's bytes with new content; its checksum, packed size and size."""
        if member.method == _DEFLATED:
            deflate = zlib.compressobj(_LEVEL, zlib.DEFLATED, -15)
            packed: Buffer = deflate.compress(content) + deflate.flush()
        else:
            packed = content
        numbers = zlib.crc32(content), len(packed), len(content)
        head = bytearray(self.data[member.header_at : member.data_at])
        tail = bytearray(self.data[member.data_at + member.packed_size : member.stop])
        # With a descriptor the header need not have them, but some programs write them twice.
        if self._local_numbers(member) == _numbers(member):
            struct.pack_into("<L", head, 14, numbers[0])
            places = self._local_places(member.header_at)
            _set(head, places["packed"], numbers[1])
            _set(head, places["size"], numbers[2])
        if member.flags & _HAS_DESCRIPTOR:
            _set_descriptor(tail, member, numbers)
        return [head, packed, tail], numbers

    def _set_entry(
        self, rest: bytearray, entry_at: int, offset: int, numbers: tuple[int, int, int] | None
    ) -> None:
        """Put a member's new offset and numbers into ``rest``, which begins with the directory."""
        at = entry_at - self._central_at
        places = {
            word: (at + place, wide)
            for word, (place, wide) in self._central_places(entry_at).items()
        }
        _set(rest, places["offset"], offset)
        if numbers is not None:
            struct.pack_into("<L", rest, at + 16, numbers[0])
            _set(rest, places["packed"], numbers[1])
            _set(rest, places["size"], numbers[2])

    def _set_end(self, rest: bytearray, shift: int) -> None:
        """Move the directory's offset in the end records by ``shift``."""
        new = self._central_at + shift
        end_at = self._end_at - self._central_at
        if struct.unpack_from("<L", rest, end_at + 16)[0] != _SEE_EXTRA:
            struct.pack_into("<L", rest, end_at + 16, new)
        if self._end_64_at >= 0:
            struct.pack_into("<Q", rest, self._end_64_at - self._central_at + 48, new)
            struct.pack_into("<Q", rest, end_at - _LOCATOR_SIZE + 8, self._end_64_at + shift)


def _numbers(member: Member) -> tuple[int, int, int]:
    return member.crc, member.packed_size, member.size


def _key(name: str) -> str:
    return name.lstrip("/").lower()


def _find_end(data: memoryview) -> int:
    """The first byte of the end record, whose comment reaches to the end of the file."""
    if data[:4] not in (_LOCAL, _END):
        raise FormatError("the file is not a zip archive", where="byte 0", hint=_DAMAGED)
    first = max(0, len(data) - _END_SIZE - _LONGEST_COMMENT)
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
        hint="the file was cut short; copy or export it again",
    )


def _inflated(packed: memoryview, member: Member) -> bytes:
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


def _set(target: bytearray, place: tuple[int, bool], value: int) -> None:
    at, wide = place
    if not wide and value >= _SEE_EXTRA:
        raise TooLargeError("a member would have more than 4 GB", hint="cut the mesh into parts")
    struct.pack_into("<Q" if wide else "<L", target, at, value)


def _set_descriptor(tail: bytearray, member: Member, numbers: tuple[int, int, int]) -> None:
    """Put new numbers into the data descriptor at the beginning of ``tail``, in its own form."""
    crc, packed, size = numbers
    for head in (_DESCRIPTOR, b""):
        for form in ("<LQQ", "<LLL"):
            old = head + struct.pack(form, member.crc, member.packed_size, member.size)
            if tail[: len(old)] == old:
                tail[: len(old)] = head + struct.pack(form, crc, packed, size)
                return
    raise FormatError(
        f"{member.name} has no data descriptor",
        where=f"byte {member.data_at + member.packed_size}",
        hint=_DAMAGED,
    )
