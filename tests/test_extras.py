"""What to install for an optional part."""

from importlib import metadata

from msal_cli.errors import install_hint

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
    # One that the installation does not know comes from the checkout.
    for known in (None, [], REQUIREMENTS):
        monkeypatch.setattr(metadata, "requires", lambda name, known=known: known)
        assert "'.[new]'" in install_hint("new")
