"""Object files: numba types and lowers a kernel, LLVM optimizes it for each processor.

Objects are kept by a hash of all that they depend on, so that only what was edited is made again.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import inspect
import os
import re
import zlib
from concurrent.futures import ProcessPoolExecutor
from importlib import metadata
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from kernel_build import numba_kernels
from kernel_build.numba_kernels import numba_type, result_types, to_dispatcher
from kernel_build.signatures import LIST, arg_types_of, kernel_of
from kernel_build.sources import source_hash
from kernel_build.targets import Target
from kernel_build.written import written_arguments
from msal_cli.kernels.library import Kernel
from msal_cli.machine import usable_cores

CACHE = Path(__file__).parents[1] / "build" / "kernels"

_ENVIRONMENT = {"NUMBA_OPT": "0", "NUMBA_CPU_NAME": "generic", "NUMBA_DISABLE_JIT": "0"}
"""numba's own optimization would put in what only this machine's processor has."""


_ZERO = r"\1 zeroinitializer"

_REFERENCES = ("NRT_incref", "NRT_decref")
"""numba's functions that count references to arrays; LLVM's pass knows them by name."""


class Built(NamedTuple):
    """A kernel for one combination of argument types, compiled.

    Attributes
    ----------
    row : its line in the table.
    files : its objects, one for each processor.
    """

    row: str
    files: tuple[Path, ...]


def build_objects(signatures: tuple[str, ...], target: Target) -> list[Built]:
    """Compile what is not in the cache, with all cores."""
    plans = [_plan(one, target) for one in signatures]
    missing = [plan for plan in plans if not plan.is_done()]
    # Combinations of one kernel share numba's work on the kernels that it calls.
    groups = [list(group) for _, group in groupby(missing, lambda one: one.kernel_name)]
    groups.sort(key=lambda group: -sum(one.weight for one in group))
    if groups:
        CACHE.mkdir(parents=True, exist_ok=True)
        workers = min(usable_cores(), len(groups))
        with ProcessPoolExecutor(workers, initializer=_prepare_worker) as pool:
            for _ in pool.map(_build_group, groups, [target] * len(groups)):
                pass
    return [plan.read() for plan in plans]


class _Plan(NamedTuple):
    signature: str
    symbol: str
    key: str
    objects: tuple[Path, ...]
    weight: int
    source_hash: str
    written: str

    @property
    def kernel_name(self) -> str:
        return self.signature.partition("(")[0]

    @property
    def lowered(self) -> Path:
        """LLVM's assembly, compressed, below lines with the entry and the types of the results."""
        return self.objects[0].with_name(f"{self.key}.ll.z")

    @property
    def results(self) -> Path:
        """The types of the results."""
        return self.objects[0].with_name(f"{self.key}.txt")

    def is_done(self) -> bool:
        return self.results.exists() and all(one.exists() for one in self.objects)

    def read(self) -> Built:
        results = self.results.read_text()
        row = "\t".join((self.signature, self.symbol, results, self.written, self.source_hash))
        return Built(row, self.objects)


def _plan(signature: str, target: Target) -> _Plan:
    kernel = kernel_of(signature)
    name = kernel.name.replace(".", "_")
    written = sorted(written_arguments(kernel))
    parts = (signature, source_hash(kernel), written, _tools())
    key = f"{name}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"
    return _Plan(
        signature,
        f"{name}_{hashlib.sha256(signature.encode()).hexdigest()[:8]}",
        key,
        tuple(CACHE / f"{key}-{target.triple}-{cpu}.o" for cpu in target.processors.values()),
        len(kernel.function.__code__.co_code),
        source_hash(kernel),
        " ".join(map(str, written)),
    )


@functools.cache
def _tools() -> str:
    """What objects depend on beside the kernels."""
    from kernel_build import lanes

    sources = [inspect.getsource(one) for one in (lower, to_object, numba_kernels, lanes)]
    versions = [metadata.version(name) for name in ("numba", "llvmlite")]
    return hashlib.sha256(repr((sources, versions, _ENVIRONMENT)).encode()).hexdigest()


def _prepare_worker() -> None:
    os.environ |= _ENVIRONMENT
    # numba makes objects by the million that are needed; searches for garbage among them take a
    # fifth of the time.
    gc.disable()


def _build_group(plans: list[_Plan], target: Target) -> None:
    for plan in plans:
        if plan.lowered.exists():
            text = zlib.decompress(plan.lowered.read_bytes()).decode()
        else:
            try:
                ir, entry, results = lower(kernel_of(plan.signature), plan.signature)
            except Exception as error:
                raise RuntimeError(f"{plan.signature} of {LIST.name}: {error}") from error
            text = "\n".join((entry, results, ir))
            _write(plan.lowered, zlib.compress(text.encode(), 1))
        entry, results, ir = text.split("\n", 2)
        for (suffix, cpu), path in zip(target.processors.items(), plan.objects, strict=True):
            _write(path, to_object(ir, entry, plan.symbol + suffix, target.triple, cpu))
        _write(plan.results, results.encode())


def _write(path: Path, data: bytes) -> None:
    """Whole or not at all, whatever other builds do."""
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    temporary.write_bytes(data)
    temporary.replace(path)


def lower(kernel: Kernel, signature: str) -> tuple[str, str, str]:
    """LLVM's assembly of a kernel, not optimized; the name of its function; its result types."""
    written = written_arguments(kernel)
    types = arg_types_of(signature)
    arguments = tuple(numba_type(one, is_written=at in written) for at, one in enumerate(types))
    # Wrappers for callers in Python would take a third of the time.
    dispatcher = to_dispatcher(kernel, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    dispatcher.compile(arguments)
    overload = dispatcher.overloads[arguments]
    entry: str = overload.fndesc.llvm_func_name
    return dispatcher.inspect_llvm(arguments), entry, result_types(overload.signature.return_type)


def to_object(ir: str, entry: str, symbol: str, triple: str, processor: str) -> bytes:
    """An object file, position independent, with one global symbol."""
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(triple).create_target_machine(
        cpu=processor, opt=3, reloc="pic", codemodel="small"
    )
    ir = re.sub(r"(?m)^target triple = .*$", f'target triple = "{triple}"', ir)
    ir = re.sub(r"(?m)^target datalayout = .*$", f'target datalayout = "{machine.target_data}"', ir)
    # Pickled exceptions, which nothing here reads; in some is the path of numba's folder.
    ir = re.sub(r"(?m)^(@\.const\.picklebuf\S* = .* constant \{[^}]*\}) .*$", _ZERO, ir)
    module = llvm.parse_assembly(ir)
    for at, one in enumerate([*module.functions, *module.global_variables]):
        if one.name == entry:
            one.name = symbol
        elif not one.is_declaration:
            # In its names numba counts what else the process has compiled before.
            name = one.name if one.name in _REFERENCES else f"inner{at}"
            one.name, one.linkage = name, "internal"
    options: Any = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = True
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    # numba counts references of arrays wherever it passes them on, in inner loops too, and by
    # atomic operations. What is left once functions are inlined, and pairs are dropped, counts
    # arrays that a kernel has made itself: no other thread sees them.
    references = llvm.create_new_module_pass_manager()
    references.add_refprune_pass()
    references.add_lower_atomic_pass()
    references.run(module, builder)
    builder.getModulePassManager().run(module, builder)
    made: bytes = machine.emit_object(module)
    return made
