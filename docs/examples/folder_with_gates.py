"""Denoise a folder, and end with status 1 if a file fails or a gate is broken.

    python docs/examples/folder_with_gates.py [INPUT [OUTPUT]]

The same call again does only what is new or changed.
"""

import logging
import sys
from pathlib import Path

import msal_cli as msal

SAMPLES = Path(__file__).resolve().parents[2] / "sample_meshes"

GATES = ["volume.valid and abs(volume_change) > 1%", "flipped_faces > 20", "max_displacement > 2e"]


def main(inputs: str, output: str) -> int:
    """Print a line for each file; the exit status."""
    bad = 0
    for record in msal.denoise_folder(inputs, output, include="*_noisy*", fail_on=GATES):
        broken = [gate for gate in record.gates if gate.broken]
        if record.error is not None:
            print(f"FAILED  {record.input}: {record.error.code}: {record.error.message}")
        else:
            print(f"{'BROKEN' if broken else 'ok':7} {record.input}: {record.status}")
        for gate in broken:
            print(f"        {gate.expression}: {gate.reason}")
        bad += record.error is not None or bool(broken)
    return 1 if bad else 0


# Worker processes are fresh interpreters, so this guard is good style and no need.
if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING)
    sys.exit(main(*(sys.argv[1:] or [str(SAMPLES), "denoised"])))
