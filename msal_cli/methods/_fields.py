"""The parameters of methods, as fields of their dataclasses ``Parameters``."""

import math
from dataclasses import field
from typing import Any


def parameter(
    default: Any,
    help: str,
    *,
    symbol: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    above: float | None = None,
    below: float | None = None,
    choices: tuple[str, ...] = (),
    unit: str = "",
    more: str = "",
) -> Any:
    """A dataclass field with the metadata of ``ParameterSpec``.

    ``above`` and ``below`` are open ends of the range.
    """
    return field(
        default=default,
        metadata={
            "symbol": symbol,
            "low": low if above is None else above,
            "high": high if below is None else below,
            "low_open": above is not None,
            "high_open": below is not None,
            "choices": choices,
            "unit": unit,
            "help": help,
            "more": more,
        },
    )


def passes(default: int, help: str, more: str, *, symbol: str = "", high: int = 1000) -> Any:
    return parameter(default, help, symbol=symbol, low=0, high=high, more=more)


def iterations(default: int, help: str, more: str = "smoother") -> Any:
    return passes(default, help, more, symbol="n")


def vertex_passes(
    default: int,
    help: str = "passes that fit the vertices to the filtered normals",
    more: str = "faces closer to their normals, vertices farther from the scan",
) -> Any:
    return passes(default, help, more)


def mollify(
    default: int = 1,
    help: str = "passes that average the normals over the one-ring before the first sweep",
    more: str = "smoother normals: flatter flats under heavy noise, softer edges",
) -> Any:
    return passes(default, help, more, high=100)


def share(
    default: float, help: str, more: str, *, symbol: str = "", above: float | None = None
) -> Any:
    ends: dict[str, Any] = {"low": 0.0, "above": above, "high": 1.0}
    return parameter(default, help, symbol=symbol, more=more, **ends)


def step(
    default: float,
    help: str = "time step of the first sweep; vertices with a smaller limit of stability take "
    "that",
    more: str = "smoother, up to the limit of each vertex",
    *,
    symbol: str = "tau",
    high: float = 1000.0,
) -> Any:
    """A time step of a flow, which is an area."""
    unit = "squared mean edge lengths"
    return parameter(default, help, symbol=symbol, above=0.0, high=high, unit=unit, more=more)


def boundary(default: str, free: str = "fitted like the others to the faces that they have") -> Any:
    """The parameter ``boundary``, free or fixed; the argument ``free`` describes the former."""
    # The default is the first choice.
    order = 1 if default == "free" else -1
    meanings = ", or ".join((free, "fixed")[::order])
    return parameter(
        default, f"vertices at open edges: {meanings}", choices=("free", "fixed")[::order]
    )


def sliding(default: str = "kept") -> Any:
    """The parameter of ``undo_sliding``."""
    return parameter(
        default,
        "the way that vertices came sideways: kept; undone at the end, for scans whose noise is "
        "along their normals, so that only heights are wrong; or auto, undone on such scans",
        choices=("kept", "undone", "auto"),
    )


def rim() -> Any:
    """The parameter ``boundary`` of averages over one-rings."""
    return parameter(
        "curve",
        "vertices at open edges: averaged along the rim only, as a curve; with all the neighbours "
        "they have, which draws the rim inwards; or fixed",
        choices=("curve", "free", "fixed"),
    )


def quantile() -> Any:
    return share(
        0.99,
        "robust schedule: quantile of sigma, from 0 to 1, that replaces max sigma",
        "smoother; 1 is the multiscale schedule",
        symbol="q",
        above=0.0,
    )


def noise(of: str = "wiener schedule: ") -> Any:
    return parameter(
        0.0,
        of + "standard deviation of the noise; 0 estimates it",
        low=0.0,
        high=100.0,
        unit="mean edge lengths",
        more="smoother, above 0",
    )


def caution(default: float = 1.0, of: str = "wiener schedule: ") -> Any:
    return parameter(
        default,
        of + "factor of the assumed power of the noise",
        low=0.0,
        high=100.0,
        more="smoother, less texture",
    )
