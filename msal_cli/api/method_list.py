"""``list_methods``: the methods and their parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from msal_cli.api.names import MethodName


@dataclass(frozen=True)
class MethodInfo:
    """A method for ``denoise``.

    Attributes
    ----------
    name : what ``method=`` takes.
    summary : what it does, in one line.
    parameters : what each parameter means, by name: its range, its default, and what more of it
        does.
    """

    name: MethodName
    summary: str
    parameters: Mapping[str, str]


def list_methods() -> tuple[MethodInfo, ...]:
    """All methods with their parameters, as ``msal methods`` shows them.

    Parameters
    ----------
    There are none.

    Returns
    -------
    A MethodInfo for each, in alphabetical order.  ``"adaptive"`` and ``"auto"``, which choose one,
    are not among them.

    Raises
    ------
    Nothing.
    """
    from msal_cli import methods

    found = []
    for name in methods.names():
        method = methods.find(name)
        parameters = {
            spec.name: f"{spec.help} {spec.range_text}; default {spec.default}"
            + (f"; more is {spec.more}" if spec.more else "")
            for spec in method.parameters
        }
        found.append(MethodInfo(cast(MethodName, name), method.summary, parameters))
    return tuple(found)
