"""The version of msal, written once."""

__version__ = "0.1.0"
