"""What to install for an optional part."""

from importlib import metadata

import pytest

from msal_cli.errors import install_hint

pytestmark = pytest.mark.ci

REQUIREMENTS = [
    "numpy>=1.26",
    "fsspec>=2024.2; extra == 'cloud'",
    's3fs>=2024.2 ; extra == "cloud"',
    "distributed>=2024.1; extra == 'dask'",
]


def test_the_packages_of_an_extra_are_named(monkeypatch):
    monkeypatch.setattr(metadata, "requires", lambda name: REQUIREMENTS)
    assert install_hint("cloud") == (
        "pip install 'fsspec>=2024.2' 's3fs>=2024.2' (that is msal-cli[cloud])"
    )
    assert install_hint("dask") == "pip install 'distributed>=2024.1' (that is msal-cli[dask])"


@pytest.mark.parametrize("requirements", [None, [], REQUIREMENTS])
def test_an_extra_that_the_installation_does_not_know_comes_from_the_checkout(
    monkeypatch, requirements
):
    monkeypatch.setattr(metadata, "requires", lambda name: requirements)
    assert "'.[new]'" in install_hint("new")
