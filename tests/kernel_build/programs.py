"""A program in C that calls kernels with given arrays, for systems that have no Python here."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from kernel_build import linking, objects
from kernel_build.signatures import kernel_of
from kernel_build.targets import Target
from msal_cli.kernels import library
from msal_cli.kernels.compiled import arg_type

_C_TYPES = {"i8": "int64_t", "u8": "uint64_t", "f8": "double", "b1": "uint8_t"}

Call = tuple[str, tuple[Any, ...]]
"""A kernel by its name, such as ``quantiles._counted``, with arguments."""


def build_program(calls: list[Call], target: Target, folder: Path) -> Path:
    """Compile and link a program that writes all arrays, as they are after the calls."""
    suffix, processor = next(iter(target.processors.items()))
    files, body = [], ["#include <stdint.h>", "#include <stdio.h>", "#include <string.h>"]
    lines = []
    for number, (name, arguments) in enumerate(calls):
        line = library.signature(name, tuple(map(arg_type, arguments)))
        ir, entry, _ = objects.lower(kernel_of(line), line)
        symbol = f"kernel{number}{suffix}"
        files.append(folder / f"{symbol}.o")
        files[-1].write_bytes(objects.to_object(ir, entry, symbol, target.triple, processor))
        types, words = ["void *", "void *"], ["result", "&failure"]
        for at, argument in enumerate(arguments):
            if not isinstance(argument, np.ndarray):
                types.append(_C_TYPES[arg_type(argument)])
                words.append(repr(argument))
                continue
            array = f"array{number}_{at}"
            data = ", ".join(map(str, np.ascontiguousarray(argument).tobytes()))
            body.append(f"static _Alignas(64) unsigned char {array}[] = {{{data}}};")
            sizes = [argument.size, argument.itemsize]
            types += ["void *", "void *", "int64_t", "int64_t", "void *"]
            words += ["0", "0", *map(str, sizes), array]
            types += ["int64_t"] * 2 * argument.ndim
            words += map(str, (*argument.shape, *argument.strides))
            lines.append((number, f"fwrite({array}, 1, sizeof {array}, stdout);"))
        body.append(f"int32_t {symbol}({', '.join(types)});")
        lines.append((number - 0.5, f"if ({symbol}({', '.join(words)})) return 1;"))
    body.append("int main(void) { char result[256]; void *failure = 0; memset(result, 0, 256);")
    body += [line for _, line in sorted(lines, key=lambda line: line[0])]
    source = folder / "program.c"
    source.write_text("\n".join([*body, "return 0; }"]))
    program = folder / "program.exe"
    command = [*linking.ZIG, "-O1", "-target", target.zig, "-o", str(program), str(source)]
    command += [str(linking.RUNTIME), *map(str, files), "-lm"]
    command += ["-static"] if "musl" in target.zig else []
    subprocess.run(command, check=True, capture_output=True)
    return program


def native_output(calls: list[Call]) -> bytes:
    """What the program should write: all arrays after the same calls here."""
    written = []
    for name, arguments in calls:
        own = [
            argument.copy() if isinstance(argument, np.ndarray) else argument
            for argument in arguments
        ]
        kernel_of(f"{name}()")(*own)
        written += [argument.tobytes() for argument in own if isinstance(argument, np.ndarray)]
    return b"".join(written)
