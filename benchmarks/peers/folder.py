"""One peer's own loop over a folder, in one process.

    python folder.py SCRIPT INPUT_FOLDER OUTPUT_FOLDER

SCRIPT is the name of one of the scripts here, without ``.py``.
"""

import importlib
import os
import sys


def main(script, source, target):
    """Every file of the folder, in the order of the names, under the same names."""
    denoise = importlib.import_module(script).denoise
    for name in sorted(os.listdir(source)):
        denoise(os.path.join(source, name), os.path.join(target, name))


if __name__ == "__main__":
    main(*sys.argv[1:])
