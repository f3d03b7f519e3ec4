"""``python -m msal_cli`` is the same command as ``msal``; both begin here."""

import gc
import os
import signal

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # Ctrl-C while Python still reads its modules would be answered with a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

if gc.isenabled():
    # Modules being imported make many objects and no garbage; to search them for it at Python's own
    # pace takes a twentieth of the time of a small mesh.
    gc.set_threshold(100_000, 10, 10)

if "OPENBLAS_NUM_THREADS" not in os.environ:
    # numpy's BLAS has a few small matrices to multiply here.  Its threads would wait for more and
    # be busy at it, and a product that they share may differ in its last bit.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"

from msal_cli.cli.main import main

if __name__ == "__main__":
    main()
