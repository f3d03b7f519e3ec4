"""``python -m msal_cli`` is the same command as ``msal``."""

from msal_cli.cli.main import main

if __name__ == "__main__":
    main()
