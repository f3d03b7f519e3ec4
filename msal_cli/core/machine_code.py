"""Machine code of kernels: kept on the disk, found again, and loaded without numba.

A file holds the object code that numba made of one kernel for one combination of argument types.
It is written under another name and moved, and is checked by a hash before it is loaded, so that
any number of processes may start at once on an empty cache, and a torn file is only made again.

The cache lies beside this package where that can be written, else in the user's cache folder;
``MSAL_CACHE_DIR`` in the environment names another place for it.  A folder that others may write
is not used, see ``trusted``.
"""

from __future__ import annotations

import ctypes
import errno
import functools
import hashlib
import importlib.util
import json
import logging
import os
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msal_cli.core import elf_image, trusted
from msal_cli.dataclass import dataclass

try:
    import fcntl
except ImportError:
    fcntl = None  # type: ignore[assignment]

_MAGIC = b"msal machine code 1\n"
_SUFFIX = ".msal-kernel"
_LOCKS = ".msal-kernel-locks"
# Closing a file lets go of all locks that the process has in it, so helpers have their own file.
_HELPERS = ".msal-kernel-helpers"
_LONGEST_WAIT_S = 30.0
_BETWEEN_TRIES_S = 0.01

WRITING = threading.Lock()
"""Held while a file is written: who must end this process waits for it."""

_log = logging.getLogger("msal.core")

_C_TYPES: dict[str, Any] = {
    "bool": ctypes.c_uint8,
    "int8": ctypes.c_int8,
    "int16": ctypes.c_int16,
    "int32": ctypes.c_int32,
    "int64": ctypes.c_int64,
    "uint8": ctypes.c_uint8,
    "uint16": ctypes.c_uint16,
    "uint32": ctypes.c_uint32,
    "uint64": ctypes.c_uint64,
    "float32": ctypes.c_float,
    "float64": ctypes.c_double,
}


@dataclass(frozen=True)
class Code:
    """The object code of a kernel.

    Attributes
    ----------
    symbol : the function's name in it.
    results : name of the type of its result, several for a tuple, None for no result.
    code : the object file.
    """

    symbol: str
    results: list[str] | str | None
    code: bytes


# On the disk


def found(name: str, said: str) -> Code | None:
    """The code that was kept for the kernel ``name`` under the key ``said``, if any is whole."""
    for folder in _folders():
        code = _read(folder / _file_name(name, said))
        if code is not None:
            return code
    return None


def keep(name: str, said: str, code: Code) -> None:
    """Keep code for later processes, in the first place that can be written, if there is one."""
    header = json.dumps({"symbol": code.symbol, "results": code.results}).encode()
    body = header + b"\n" + code.code
    data = _MAGIC + hashlib.sha256(body).digest() + body
    for folder in _folders():
        try:
            _write(folder, _file_name(name, said), data)
        except OSError:
            continue
        return


@contextmanager
def alone(name: str, said: str) -> Iterator[None]:
    """Have other processes wait while the code of a kernel is made; it is for them too.

    Without this, as many processes as start at once on an empty cache would all make all of it.
    Whoever waits does so for ``_LONGEST_WAIT_S`` at most.  Where nothing can be kept, or the system
    has no such locks, nobody waits.  The lock of a process that ends goes with it.
    """
    handle = _lock_file(_LOCKS)
    if handle is None:
        yield
        return
    place = _place(name, said)
    deadline = time.monotonic() + _LONGEST_WAIT_S
    try:
        while not _is_locked(handle, place) and time.monotonic() < deadline:
            time.sleep(_BETWEEN_TRIES_S)
        yield
    finally:
        os.close(handle)


@contextmanager
def if_in_nobodys_hand(name: str, said: str) -> Iterator[bool]:
    """Whether nobody makes the code of a kernel, who then wait as in ``alone``.

    Where nothing can be kept, or the system has no such locks, there is no use in making it.
    """
    handle = _lock_file(_LOCKS)
    if handle is None:
        yield False
        return
    try:
        yield _is_locked(handle, _place(name, said))
    finally:
        os.close(handle)


@contextmanager
def as_helper(number: int) -> Iterator[bool]:
    """Whether this process is the only helper of that number (see ``ahead``) on this cache."""
    handle = _lock_file(_HELPERS)
    if handle is None:
        yield False
        return
    try:
        yield _is_locked(handle, number)
    finally:
        os.close(handle)


def is_nobody_helping() -> bool:
    """Whether the cache can be written, and has no helper of number 0 yet."""
    with as_helper(0) as is_needed:
        return is_needed


def _place(name: str, said: str) -> int:
    return int(_digest(name, said)[:7], 16)


def _lock_file(name: str) -> int | None:
    """The file in which every kernel, or helper, has a byte to lock, open; None if none can be."""
    if fcntl is None:
        return None
    for folder in _folders():
        try:
            trusted.make_folder(folder)
            return trusted.open_file(folder / name, os.O_RDWR | os.O_CREAT)
        except OSError:
            continue
    return None


def _is_locked(handle: int, place: int) -> bool:
    """Take the lock if it is free; a file system without locks counts as free."""
    assert fcntl is not None
    try:
        fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN)
    return True


def _digest(name: str, said: str) -> str:
    return hashlib.sha256(f"{name} {_machine()} {said}".encode()).hexdigest()


def _file_name(name: str, said: str) -> str:
    return f"{name}-{_digest(name, said)[:32]}{_SUFFIX}"


def _folders() -> list[Path]:
    """The places for the cache that can be trusted, the best first."""
    refusals: list[str] = []
    folders = trusted.only_trusted(_candidates(), refusals)
    if not folders and refusals:
        _warn(refusals[0])
    return folders


@functools.cache
def _warn(refusal: str) -> None:
    _log.warning(
        "kernels are compiled in memory, in each process again: %s; make it writable for you alone "
        "(chmod go-w), or name another folder with MSAL_CACHE_DIR",
        refusal,
    )


def _candidates() -> list[Path]:
    chosen = os.environ.get("MSAL_CACHE_DIR")
    if chosen:
        return [Path(chosen)]
    folders = [Path(__file__).parent / "__pycache__"]
    home = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME")
    if home or os.path.expanduser("~") != "~":
        folders.append(Path(home or os.path.expanduser("~/.cache")) / "msal")
    return folders


def _read(path: Path) -> Code | None:
    try:
        with open(trusted.open_file(path, os.O_RDONLY), "rb") as file:
            data = file.read()
    except OSError:
        return None
    start = len(_MAGIC) + hashlib.sha256().digest_size
    body = data[start:]
    if data[:start] != _MAGIC + hashlib.sha256(body).digest():
        return None
    header, _, code = body.partition(b"\n")
    return Code(**json.loads(header), code=code)


def _write(folder: Path, name: str, data: bytes) -> None:
    trusted.make_folder(folder)
    # Containers that share a folder may share numbers of processes too.
    temporary = folder / f".{name}.{os.getpid()}-{os.urandom(4).hex()}.tmp"
    with WRITING:
        try:
            os.close(trusted.open_file(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
            temporary.write_bytes(data)
            temporary.replace(folder / name)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise


@functools.cache
def _machine() -> str:
    """What machine code depends on beside its source."""
    settings = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_")}
    said = (
        sys.version,
        _version("numba"),
        _version("llvmlite"),
        _processor(),
        sorted(settings.items()),
    )
    return hashlib.sha256(repr(said).encode()).hexdigest()


# In memory


def loaded(code: Code, kinds: tuple[Any, ...]) -> Callable[..., Any]:
    """A function that runs ``code`` with arguments of these kinds (see ``compiled.kind``).

    It raises RuntimeError where the kernel raises an exception.
    """
    owner, address = _in_memory(code)
    function = _prototype(kinds)(address)
    names = [code.results] if isinstance(code.results, str) else code.results or []
    result_type = _structure(tuple(names))
    fields = [f"r{at}" for at in range(len(names))]
    is_tuple = isinstance(code.results, list)
    are_arrays = [not isinstance(one, str) for one in kinds]

    # The code must live as long as whoever calls it.
    def call(*arguments: Any, owner: Any = owner) -> Any:
        failure = ctypes.c_void_p()
        result = result_type()
        passed: list[Any] = [ctypes.addressof(result), ctypes.addressof(failure)]
        for argument, is_array in zip(arguments, are_arrays, strict=True):
            if is_array:
                passed += (None, None, argument.size, argument.itemsize, argument.ctypes.data)
                passed += argument.shape
                passed += argument.strides
            else:
                # A number of numpy's is none of ctypes'.
                passed.append(argument.item() if hasattr(argument, "item") else argument)
        if function(*passed):
            raise RuntimeError(f"the kernel {code.symbol} failed")
        if not fields:
            return None
        values = [getattr(result, field) for field in fields]
        return tuple(values) if is_tuple else values[0]

    return call


def _in_memory(code: Code) -> tuple[Any, int]:
    """What keeps the code in memory, and the address of its function."""
    if elf_image.is_usable():
        try:
            image = elf_image.Image(code.code, _address_of)
            return image, image.address(code.symbol)
        except elf_image.UnknownObjectError as reason:
            _log.info("LLVM loads %s: %s", code.symbol, reason)
    return _by_llvm(code)


def _by_llvm(code: Code) -> tuple[Any, int]:
    import llvmlite.binding as llvm

    # An engine owns its target machine, and frees it in the end.
    machine = _target().create_target_machine(jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code.code))
    engine.finalize_object()
    return engine, engine.get_function_address(code.symbol)


def _prototype(kinds: tuple[Any, ...]) -> Any:
    """How numba's functions are called: where the result goes, where a failure goes, arguments.

    An array becomes its owner and parent (unused here), size, item size, address, shape, strides.
    """
    size = ctypes.c_ssize_t
    slots: list[Any] = [ctypes.c_void_p, ctypes.c_void_p]
    for one in kinds:
        if isinstance(one, str):
            slots.append(_C_TYPES[one])
        else:
            slots += [ctypes.c_void_p, ctypes.c_void_p, size, size, ctypes.c_void_p]
            slots += [size] * (2 * one[1])
    return ctypes.CFUNCTYPE(ctypes.c_int32, *slots)


@functools.cache
def _structure(names: tuple[str, ...]) -> Any:
    fields = [
        (f"r{at}", ctypes.c_bool if name == "bool" else _C_TYPES[name])
        for at, name in enumerate(names)
    ]
    # Code without a result still clears the place where it would be.
    return type("Result", (ctypes.Structure,), {"_fields_": fields or [("none", ctypes.c_void_p)]})


def _address_of(name: str) -> int:
    """The address of a function that numba's code calls; KeyError if there is none."""
    helpers = _helpers()
    if name in helpers:
        return helpers[name]
    for library in (None, "libm.so.6"):
        try:
            function = getattr(ctypes.CDLL(library), name)
        except (AttributeError, OSError):
            continue
        address = ctypes.cast(function, ctypes.c_void_p).value
        if address:
            return address
    raise KeyError(name)


@functools.cache
def _helpers() -> dict[str, int]:
    """Addresses of what numba's code calls in numba's own libraries, by name."""
    helpers = {}
    for module, path, prefix in (
        ("numba.core.runtime._nrt_python", "core/runtime/_nrt_python", "NRT_"),
        ("numba._helperlib", "_helperlib", "numba_"),
    ):
        library = sys.modules.get(module) or _extension(path)
        for name, address in library.c_helpers.items():
            helpers[name if name.startswith("_") else prefix + name] = address
    return helpers


@functools.cache
def _target() -> Any:
    """LLVM, ready to load, with numba's helpers made known to it."""
    import llvmlite.binding as llvm

    for name, address in _helpers().items():
        llvm.add_symbol(name, address)
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


def _folder_of(package: str) -> Path:
    """The folder of a package, which is not imported."""
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        raise ImportError(f"{package} is not installed", name=package)
    return Path(spec.origin).parent


def _version(package: str) -> str:
    return (_folder_of(package) / "_version.py").read_text(errors="replace")


def _processor() -> tuple[str, ...]:
    """What tells processors apart that do not run the same code."""
    if elf_image.is_usable():
        try:
            lines = Path("/proc/cpuinfo").read_text().split("\n\n", 1)[0].splitlines()
        except OSError:
            lines = []
        known = dict(part for line in lines if len(part := line.split("\t: ", 1)) == 2)
        words = ("vendor_id", "cpu family", "model", "flags")
        said = {name.strip(): value for name, value in known.items()}
        if all(word in said for word in words):
            return tuple(said[word] for word in words)
    import llvmlite.binding as llvm

    return (
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
    )


def _extension(path: str) -> types.ModuleType:
    """A compiled module of numba without the package around it, whose import takes the time."""
    from importlib.machinery import EXTENSION_SUFFIXES

    files = [_folder_of("numba") / f"{path}{suffix}" for suffix in EXTENSION_SUFFIXES]
    file = next((one for one in files if one.exists()), None)
    if file is None:
        raise ImportError(f"numba has no {path}", name="numba")
    spec = importlib.util.spec_from_file_location(file.name.partition(".")[0], file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
