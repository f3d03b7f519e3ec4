"""``python -m msal_cli`` is the same command as ``msal``; both begin here."""

import signal

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # Ctrl-C while Python still reads its modules would be answered with a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from msal_cli.cli.main import main

if __name__ == "__main__":
    main()
