"""Object files of 64-bit Linux on x86, put into memory and made ready to run.

LLVM's own loader does this everywhere, but its library alone takes 45 MB and 30 ms of every
process.  numba makes its code for addresses of any size, so that every place to be filled in is a
plain 64-bit address; an object file with anything else is refused, and goes to LLVM.
"""

from __future__ import annotations

import ctypes
import mmap
import platform
import struct
import sys
from collections.abc import Callable

from msal_cli.dataclass import dataclass

_HEADER = struct.Struct("<16sHHIQQQIHHHHHH")
_SECTION = struct.Struct("<IIQQQQIIQQ")
_SYMBOL = struct.Struct("<IBBHQQ")
_RELOCATION = struct.Struct("<QQq")

_LITTLE_64 = b"\x7fELF\x02\x01"
_RELOCATABLE, _X86_64 = 1, 62
_PROGRAM, _SYMBOLS, _RELOCATIONS, _NO_BITS = 1, 2, 4, 8
_WRITABLE, _IN_MEMORY = 1, 2
_UNDEFINED, _ABSOLUTE, _COMMON, _LARGE_COMMON = 0, 0xFFF1, 0xFFF2, 0xFF02
_ADDRESS_64 = 1


class UnknownObjectError(Exception):
    """An object file that holds what is not dealt with here."""


@dataclass(frozen=True)
class _Section:
    name: str
    kind: int
    flags: int
    offset: int
    size: int
    link: int
    info: int
    alignment: int

    @property
    def is_loaded(self) -> bool:
        # Tables for unwinding serve exceptions of C++, which pass through no kernel.
        return bool(self.flags & _IN_MEMORY) and self.size > 0 and self.name != ".eh_frame"


class Image:
    """The code and constants of an object file in memory, for as long as this object lives.

    Parameters
    ----------
    data : the object file.
    address_of : the address of a function that the code calls, by name; raises KeyError.

    Raises
    ------
    UnknownObjectError
        for a file that is not plain code for this machine.
    """

    def __init__(self, data: bytes, address_of: Callable[[str], int]) -> None:
        sections = _sections(data)
        places, size = _layout(sections)
        symbols = _symbols(data, sections)
        common: dict[str, int] = {}
        for name, (home, _, alignment, length) in symbols.items():
            if home in (_COMMON, _LARGE_COMMON):
                size = -(-size // max(alignment, 1)) * max(alignment, 1)
                common[name] = size
                size += length
        self._memory = mmap.mmap(-1, max(size, 1))
        self._base = ctypes.addressof(ctypes.c_char.from_buffer(self._memory))
        for at, section in enumerate(sections):
            if section.is_loaded and section.kind == _PROGRAM:
                end = places[at] + section.size
                piece = data[section.offset : section.offset + section.size]
                self._memory[places[at] : end] = piece
        self._addresses: dict[str, int] = {}
        for name, (home, value, _, _) in symbols.items():
            if name in common:
                self._addresses[name] = self._base + common[name]
            elif home in places:
                self._addresses[name] = self._base + places[home] + value
        self._fill_in(data, sections, places, address_of)
        self._seal()

    def address(self, name: str) -> int:
        """Where a function of the file lies."""
        return self._addresses[name]

    def _fill_in(
        self,
        data: bytes,
        sections: list[_Section],
        places: dict[int, int],
        address_of: Callable[[str], int],
    ) -> None:
        for table in sections:
            if table.kind != _RELOCATIONS or table.info not in places:
                continue
            names = _symbol_list(data, sections, sections[table.link])
            for at in range(table.offset, table.offset + table.size, _RELOCATION.size):
                offset, info, addend = _RELOCATION.unpack_from(data, at)
                if info & 0xFFFFFFFF != _ADDRESS_64:
                    raise UnknownObjectError(f"a relocation of type {info & 0xFFFFFFFF}")
                name, section, value = names[info >> 32]
                if section in places:
                    address = self._base + places[section] + value
                elif section == _ABSOLUTE:
                    address = value
                elif name in self._addresses:
                    address = self._addresses[name]
                else:
                    try:
                        address = self._addresses[name] = address_of(name)
                    except KeyError:
                        raise UnknownObjectError(f"there is no {name}") from None
                struct.pack_into(
                    "<Q", self._memory, places[table.info] + offset, (address + addend) % (1 << 64)
                )

    def _seal(self) -> None:
        """No page can be written and run at once."""
        libc = ctypes.CDLL(None, use_errno=True)
        wanted = mmap.PROT_READ | mmap.PROT_EXEC
        if libc.mprotect(ctypes.c_void_p(self._base), ctypes.c_size_t(len(self._memory)), wanted):
            raise UnknownObjectError("the system does not let memory become code")


def is_usable() -> bool:
    """Whether this process is of the kind whose object files are understood here."""
    is_64_bit = sys.maxsize > 1 << 32
    return sys.platform == "linux" and platform.machine() == "x86_64" and is_64_bit


def _sections(data: bytes) -> list[_Section]:
    if len(data) < _HEADER.size or not data.startswith(_LITTLE_64):
        raise UnknownObjectError("no object file of 64 bits")
    header = _HEADER.unpack_from(data)
    if header[1:3] != (_RELOCATABLE, _X86_64):
        raise UnknownObjectError("no object file of this machine")
    table, entry_size, count, names_at = header[6], header[11], header[12], header[13]
    raw = [_SECTION.unpack_from(data, table + k * entry_size) for k in range(count)]
    names = data[raw[names_at][4] : raw[names_at][4] + raw[names_at][5]]
    sections = [
        _Section(_text(names, one[0]), one[1], one[2], one[4], one[5], one[6], one[7], one[8])
        for one in raw
    ]
    for one in sections:
        if one.is_loaded and (one.flags & _WRITABLE or one.kind not in (_PROGRAM, _NO_BITS)):
            raise UnknownObjectError(f"the section {one.name}")
    return sections


def _layout(sections: list[_Section]) -> tuple[dict[int, int], int]:
    """Where each loaded section goes, by its number, and the size of all."""
    places: dict[int, int] = {}
    size = 0
    for at, section in enumerate(sections):
        if section.is_loaded:
            alignment = max(section.alignment, 1)
            size = -(-size // alignment) * alignment
            places[at] = size
            size += section.size
    return places, size


def _symbol_list(
    data: bytes, sections: list[_Section], table: _Section
) -> list[tuple[str, int, int]]:
    """Name, section and value of every symbol of a table."""
    names = data[sections[table.link].offset :][: sections[table.link].size]
    found = []
    for at in range(table.offset, table.offset + table.size, _SYMBOL.size):
        name, _, _, section, value, _ = _SYMBOL.unpack_from(data, at)
        found.append((_text(names, name), section, value))
    return found


def _symbols(data: bytes, sections: list[_Section]) -> dict[str, tuple[int, int, int, int]]:
    """Section, value, alignment and size of every symbol that is defined here, by name."""
    found = {}
    for table in sections:
        if table.kind != _SYMBOLS:
            continue
        names = data[sections[table.link].offset :][: sections[table.link].size]
        for at in range(table.offset, table.offset + table.size, _SYMBOL.size):
            name, _, _, section, value, size = _SYMBOL.unpack_from(data, at)
            if name and section != _UNDEFINED:
                # Of a common symbol the value is the alignment.
                found[_text(names, name)] = (section, value, value, size)
    return found


def _text(names: bytes, at: int) -> str:
    return names[at : names.index(b"\0", at)].decode()
