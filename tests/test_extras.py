"""What to install for an optional part."""

import re
import tomllib
from pathlib import Path

from msal_cli.errors import EXTRAS, install_hint


def test_the_packages_of_an_extra_are_named():
    text = (Path(__file__).parent.parent / "pyproject.toml").read_text("utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    for extra, words in EXTRAS.items():
        assert words.split() == [re.split("[<>=]", package)[0] for package in extras[extra]]
    assert install_hint("dask") == "pip install distributed (that is msal-cli[dask])"
