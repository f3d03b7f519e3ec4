"""Memory of this process: how much it took, whether there was too little, and how that is said."""

from __future__ import annotations

import errno


def is_want_of_memory(error: BaseException | None) -> bool:
    """Whether an error, or what it was raised from, comes of memory that was not given."""
    while error is not None:
        said = str(error)
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if isinstance(error, ImportError) and "allocate memory" in said:
            return True
        if isinstance(error, RuntimeError) and "can't start new thread" in said:
            return True
        error = error.__cause__
    return False


def megabytes(n_bytes: int, *, rounded_up: bool = True) -> str:
    """``499 MB`` or ``3.21 GB``, rounded so that what is refused never looks as if it fitted."""
    unit, digits = (10**6, 0) if n_bytes <= 999 * 10**6 else (10**9, 2)
    step = unit // 10**digits
    steps = -(-n_bytes // step) if rounded_up else n_bytes // step
    return f"{steps} MB" if unit == 10**6 else f"{steps / 100:.2f} GB"


def peak_bytes() -> int | None:
    """The largest resident size of this process so far; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    import sys

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
