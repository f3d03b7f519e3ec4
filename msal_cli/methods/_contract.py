"""The contract of a method: parameters that describe themselves, and a pure function.

A module of this folder whose name does not start with an underscore is a method.  It has

- a docstring whose first line is the summary and which has a ``Source:`` line, - a frozen dataclass
``Parameters`` whose fields are made by ``_fields``, - a function ``denoise(mesh, parameters,
on_sweep) -> Result``, - ``BYTES_PER_FACE``, if it needs more memory than ``al`` does (see
``Method.bytes_per_face``).

Validation, ``--set``, ``msal methods``, the docs table and the reports are all made from these.
"""

import dataclasses
import difflib
import functools
import inspect
import math
import time
import typing
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

from msal_cli.arrays import Floats
from msal_cli.errors import UsageError
from msal_cli.light_dataclass import dataclass, field
from msal_cli.mesh import Mesh

OnSweep = Callable[[int, int], None]  # called as ``on_sweep(done, iterations)`` after each sweep


@dataclass(frozen=True, eq=False)
class Result:
    """What a method returns."""

    vertices: Floats  # (n, 3) new positions; the mesh itself is not changed
    # per-vertex arrays (n,) for display, such as ``fidelity``
    fields: dict[str, Floats] = field(default_factory=dict)
    # wall-clock seconds by stage, ``normals`` and ``sweeps``
    seconds: dict[str, float] = field(default_factory=dict)


class Timer:
    """Wall-clock seconds of the stages of one run: ``normals`` until ``start_sweeps``."""

    def __init__(self) -> None:
        self._started = self._sweeps = time.perf_counter()

    def start_sweeps(self) -> None:
        """End the stage ``normals``."""
        self._sweeps = time.perf_counter()

    def finish(self, vertices: Floats, fields: dict[str, Floats] | None = None) -> Result:
        """End the stage ``sweeps`` and make the result."""
        seconds = {
            "normals": self._sweeps - self._started,
            "sweeps": time.perf_counter() - self._sweeps,
        }
        return Result(vertices, fields or {}, seconds)


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter as users see it."""

    # name, symbol: the name for ``--set``, and the paper's symbol, which ``--set`` accepts too
    name: str
    symbol: str
    kind: type  # ``int``, ``float`` or ``str``
    default: Any  # the value if none is given
    low: float  # low, high, low_open, high_open: the range of a number; open ends are excluded
    high: float
    low_open: bool
    high_open: bool
    # the words allowed, for ``str``; empty if ``Parameters`` checks the text itself
    choices: tuple[str, ...]
    unit: str  # of the value; empty for a pure number
    help: str  # what it is
    more: str  # the effect of a greater value

    @property
    def range_text(self) -> str:
        """The range as text: ``0 < K <= 1``, ``0, 1, 2, ...`` or the words allowed."""
        if self.choices:
            return " | ".join(self.choices)
        if self.kind is str:
            return "text"
        low = "" if math.isinf(self.low) else f"{self.low:g} {'<' if self.low_open else '<='} "
        high = "" if math.isinf(self.high) else f" {'<' if self.high_open else '<='} {self.high:g}"
        return f"{low}{self.name}{high}" + (" (whole number)" if self.kind is int else "")

    def validate(self, given: object) -> Any:
        """Convert ``given``, text or value, to a valid value; UsageError says what is allowed."""
        value: Any = given
        if self.kind is str:
            if (self.choices and value not in self.choices) or not isinstance(value, str):
                raise self._refusal(given)
            return value
        try:
            value = self.kind(given)
        except (TypeError, ValueError, OverflowError):
            raise self._refusal(given) from None
        if isinstance(given, float) and value != given:
            raise self._refusal(given)
        too_low = value < self.low or (self.low_open and value == self.low)
        too_high = value > self.high or (self.high_open and value == self.high)
        if value != value or too_low or too_high:
            raise self._refusal(given)
        return value

    def _refusal(self, given: object) -> UsageError:
        return UsageError(
            f"{self.name} = {given} is not allowed", hint=f"allowed: {self.range_text}"
        )


@functools.cache
def _specs(parameters_type: type[Any]) -> tuple[ParameterSpec, ...]:
    """The specifications of a ``Parameters`` class; cached, because --auto needs them often."""
    kinds = typing.get_type_hints(parameters_type)
    return tuple(
        ParameterSpec(spec.name, kind=kinds[spec.name], default=spec.default, **spec.metadata)
        for spec in dataclasses.fields(parameters_type)
    )


@dataclass(frozen=True, eq=False)
class Method:
    """A denoising method found in this folder."""

    name: str
    module: ModuleType

    @property
    def description(self) -> str:
        """The module's docstring."""
        return inspect.getdoc(self.module) or ""

    @property
    def summary(self) -> str:
        """The first line of the description."""
        return self.description.partition("\n")[0].rstrip(".")

    @property
    def source(self) -> str:
        """The publication, from the description's ``Source:`` line."""
        _, _, rest = self.description.partition("Source:")
        return " ".join(rest.partition("\n\n")[0].split())

    @property
    def bytes_per_face(self) -> int:
        """Peak memory in bytes per triangle beyond what each method needs.

        Measured by benchmarks/peak_memory.py at the defaults; 0 if reading a mesh takes as much.
        """
        return int(getattr(self.module, "BYTES_PER_FACE", 0))

    def bytes_per_face_of(self, given: Mapping[str, Any]) -> int:
        """As ``bytes_per_face``, for the parameters ``given`` and their schedule."""
        parameters = self.module.Parameters(**given)
        own = getattr(parameters, "bytes_per_face", self.bytes_per_face)
        return int(own) + int(getattr(parameters, "schedule_bytes_per_face", 0))

    @property
    def parameters(self) -> tuple[ParameterSpec, ...]:
        """Its parameters in the order of the dataclass."""
        return _specs(self.module.Parameters)

    def spec(self, word: str) -> ParameterSpec:
        """The parameter with that name or symbol; UsageError if there is none."""
        specs = {spec.symbol: spec for spec in self.parameters if spec.symbol}
        specs |= {spec.name: spec for spec in self.parameters}
        if word not in specs:
            names = [spec.name for spec in self.parameters]
            folded = {name.casefold(): name for name in names}
            close = difflib.get_close_matches(word.casefold(), folded, n=1)
            raise UsageError(
                f"{self.name} has no parameter '{word}'",
                hint=f"did you mean {folded[close[0]]}?"
                if close
                else f"it has: {', '.join(names)}",
            )
        return specs[word]

    def validate(self, given: Mapping[str, object]) -> dict[str, Any]:
        """All parameters: those in ``given`` (by name or symbol), validated, and defaults.

        Raises UsageError for an unknown name, a value out of range, or values that contradict each
        other, which ``Parameters`` checks when it is made.
        """
        values = {spec.name: spec.default for spec in self.parameters}
        for word, value in given.items():
            spec = self.spec(word)
            values[spec.name] = spec.validate(value)
        self.module.Parameters(**values)
        return values

    def has_data_term(self, parameters: Mapping[str, Any]) -> bool:
        """Whether complete ``parameters`` pull vertices back to their scanned positions by the
        lambda of equation (2), which a mesh's trust scales."""
        return bool(getattr(self.module.Parameters(**parameters), "has_data_term", False))

    def most_noise_edges(self, parameters: Mapping[str, Any]) -> float:
        """The strongest noise, mean edge lengths, that complete ``parameters`` are suited for."""
        return float(getattr(self.module.Parameters(**parameters), "most_noise_edges", math.inf))

    def uses_largest_sigma(self, parameters: Mapping[str, Any]) -> bool:
        """Whether lambda is scaled by the largest sigma (eq. 7), which may be that of a spike."""
        return bool(getattr(self.module.Parameters(**parameters), "uses_largest_sigma", False))

    def denoise(
        self, mesh: Mesh, parameters: Mapping[str, Any], on_sweep: OnSweep | None = None
    ) -> Result:
        """Run the method with complete, valid ``parameters``; ``mesh`` is not changed."""
        values = self.module.Parameters(**parameters)
        result: Result = self.module.denoise(mesh, values, on_sweep or (lambda done, total: None))
        return result
