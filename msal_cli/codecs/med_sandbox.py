"""A program that reads a file's bytes in a process of its own, and its answer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from msal_cli.codecs.library_guard import time_limit_s
from msal_cli.errors import FormatError, ResourceError, TooLargeError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_CONVERT = "check the file in another program, or convert it to PLY, OBJ or STL"


def answer_of(program: str, data: Buffer, format: str) -> dict[str, Any]:
    """What ``program``, a module beside this one, says of ``data``.

    The process ends with the call, whatever it does.

    Raises
    ------
    FormatError
        if it finds the file damaged, or crashes.
    UnsupportedError
        for a feature that it does not read.
    TooLargeError, ResourceError
        if it takes too much memory, or with code ``E_TIMEOUT`` if it does not end.
    """
    name = format.upper()
    limit_s = time_limit_s(len(data))
    script = Path(__file__).with_name(f"{program}.py")
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(script), str(int(limit_s) + 1)],
            input=data,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=limit_s,
            check=False,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "HDF5_PLUGIN_PRELOAD": "::"},
        )
    except subprocess.TimeoutExpired:
        raise ResourceError(
            f"this {name} file was not read within {limit_s:.0f} s",
            code="E_TIMEOUT",
            hint="the file is probably damaged; export it again, or convert it to PLY",
        ) from None
    try:
        answer: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        raise FormatError(
            f"the reader of {name} files crashed (exit status {done.returncode})", hint=_CONVERT
        ) from None
    if "unsupported" in answer:
        raise UnsupportedError(str(answer["unsupported"])[:200], hint=_CONVERT)
    if "memory" in answer:
        raise TooLargeError(f"reading this {name} file takes too much memory", hint=_CONVERT)
    if "damaged" in answer:
        raise FormatError(
            f"this {name} file is damaged: {str(answer['damaged'])[:200]}", hint=_CONVERT
        )
    return answer
