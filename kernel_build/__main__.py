"""Build the kernel library of this checkout, after an edit of a kernel:

    python -m kernel_build [--all-levels]

Only what has changed is compiled.  On x86-64 the library has code for this machine's level of
processor, with ``--all-levels`` for all of them, as in a wheel.
"""

from __future__ import annotations

import argparse

from kernel_build.build import build_for_checkout


def main(words: list[str] | None = None) -> None:
    """Build the library."""
    parser = argparse.ArgumentParser(prog="python -m kernel_build", description=__doc__)
    parser.add_argument("--all-levels", action="store_true")
    arguments = parser.parse_args(words)
    build_for_checkout(has_all_levels=arguments.all_levels)


if __name__ == "__main__":
    main()
