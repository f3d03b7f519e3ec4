"""Write the list of signatures from what the tests ask for:

    python -m kernel_build.record [--add] [PYTEST ARGUMENT...]

Without ``--add`` the list is replaced, so give no arguments that leave tests out.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from kernel_build.signatures import listed, write


def main(words: list[str]) -> None:
    """Run the tests and write the list."""
    is_added = "--add" in words
    options = [word for word in words if word != "--add"]
    with tempfile.TemporaryDirectory() as folder:
        recorded = Path(folder, "signatures.txt")
        recorded.touch()
        hook = str(Path(__file__).with_name("recording"))
        path = os.pathsep.join([hook, str(Path(__file__).parents[1]), *sys.path[1:]])
        environment = os.environ | {"PYTHONPATH": path, "MSAL_RECORDED_SIGNATURES": str(recorded)}
        subprocess.run([sys.executable, "-m", "pytest", *options], env=environment, check=False)
        signatures = set(recorded.read_text(encoding="utf-8").splitlines())
    new = signatures - set(listed())
    write(signatures | set(listed()) if is_added else signatures)
    print(
        f"{len(signatures)} signatures were used, {len(new)} of them new:", *sorted(new), sep="\n"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
