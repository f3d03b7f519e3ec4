"""What to install for an optional part of msal, such as ``msal-cli[cloud]``.

The advice names the packages that the extra stands for: msal may have come from a checkout or a
wheel, and pip would look for ``msal-cli`` itself on an index that does not have it.
"""

from __future__ import annotations

import re
import shlex

DISTRIBUTION = "msal-cli"


def install_hint(extra: str) -> str:
    """What to do where a package of an extra is missing."""
    packages = " ".join(map(shlex.quote, _packages(extra)))
    if not packages:
        return f"install {DISTRIBUTION}[{extra}]; in its checkout: pip install '.[{extra}]'"
    return f"pip install {packages} (that is {DISTRIBUTION}[{extra}])"


def _packages(extra: str) -> list[str]:
    """The requirements of an extra, as the installed distribution has them; none if it is not."""
    from importlib import metadata

    try:
        requirements = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return []
    marker = re.compile(rf"""extra\s*==\s*['"]{re.escape(extra)}['"]""")
    found = (one.partition(";") for one in requirements)
    return [name.strip() for name, _, condition in found if marker.search(condition)]
