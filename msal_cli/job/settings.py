"""Settings, limits and paths of one file, and how users write them."""

from __future__ import annotations

import dataclasses
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NoReturn, get_args

from msal_cli.errors import UsageError
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage.urls import ObjectMark

if TYPE_CHECKING:
    from msal_cli.methods import Method

Keep = Literal["texture", "edges", "shape"]
Assumption = Literal["noise", "texture"]
Encoding = Literal["same", "ascii", "binary"]
Precision = Literal["same", "float32", "float64"]
NoiseKind = Literal[
    "gaussian-normal", "gaussian", "uniform", "mixed", "impulsive", "correlated", "view",
    "quantised", "grazing", "half", "ramp", "outliers",
]  # fmt: skip

AUTO, ADAPTIVE = "auto", "adaptive"
"""Words in place of a method's name: choose a method for each mesh (see ``auto.search``), or
parameters of AL and MSAL (see ``auto.adaptive``)."""

CHOOSING = (ADAPTIVE, AUTO)
"""Words in place of a method's name that stand for a choice."""

NEGLIGIBLE = "auto"
"""In place of a length for the least noise: as the estimate judges it."""

DEFAULT_BACKUP = ".orig"
"""The suffix that is added to the name of an original that is replaced in place."""

SELF_INTERSECTIONS = "self-intersections"
"""The name of the check that counts pairs of faces which intersect each other."""


@dataclass(frozen=True)
class Settings:
    """Everything besides the input that decides the bytes of an output."""

    # method, parameters: the method's name and all its parameters, resolved; with ``AUTO`` the
    # fields of ``auto.Wishes``, with ``ADAPTIVE`` those of them that were given
    method: str
    parameters: dict[str, Any] = field(default_factory=dict)
    # suffix of the format to convert to, without a dot; None takes that of the output's name, else
    # the input's
    to: str | None = None
    encoding: str = "same"  # ``same``, ``ascii`` or ``binary``
    precision: str = "same"  # ``same``, ``float32`` or ``float64``
    strict: bool = False  # a conversion that loses something fails instead of warning
    format: str | None = None  # the input's format where its name does not show it
    # max_move, lock, weights: what keeps vertices near their place; see ``constraints``
    max_move: str | None = None
    lock: tuple[str, ...] = ()
    weights: str | None = None
    fields: tuple[str, ...] = ()  # what is written beside the output, see ``fields``
    # a mesh with less noise than this stays as it is: a length as of ``constraints``, or
    # ``NEGLIGIBLE`` for "no noise to speak of"
    min_noise: str | None = None
    checks: tuple[str, ...] = ()  # what is counted in addition: ``SELF_INTERSECTIONS``
    # whether outlier vertices are brought back before the method runs, see ``outliers``; None does
    # so where a method is chosen and the outliers are clear
    despike: bool | None = None
    tile_set: bool = False  # whether all files are denoised as one joined mesh
    unit: str | None = None  # that of the input's coordinates, one of ``METRES``

    @property
    def assume(self) -> str | None:
        """What a choice assumes if it is not known what is noise and what is texture."""
        return self.parameters.get("assume") if self.method in CHOOSING else None

    @property
    def looks_for_outliers(self) -> bool:
        return self.method in CHOOSING if self.despike is None else self.despike


@dataclass(frozen=True)
class Limits:
    """What one file may use; None is unlimited.  Limits never change the bytes of an output."""

    timeout_s: float | None = None  # seconds of wall time, enforced by the supervisor of the worker
    memory_bytes: int | None = None  # resident memory of the process that denoises it
    # folder for the arrays of a mesh that exceeds the memory; None is the output's
    scratch: str | None = None


NO_LIMITS = Limits()


@dataclass(frozen=True)
class Task:
    """One file to denoise; paths are text as ``os.fsdecode`` gives it, or URLs.

    ``relative`` is the name of the file in reports and the manifest.  With ``in_place`` the output
    is the input, and ``backup``, a suffix, keeps the original beside it.  An input in a store has
    the mark that it had when it was found.  ``manifest_dir`` is the folder whose manifest records
    the file: the output folder or, in place, the folder that was searched or contains the file;
    None if there is none (one file into one file).
    """

    input: str
    output: str
    relative: str
    in_place: bool = False
    backup: str | None = None
    input_mark: ObjectMark | None = None
    manifest_dir: str | None = None
    force: bool = False  # replace even materials that an earlier output has beside it
    depth: int = 0  # folders between the searched folder and the file

    @property
    def backup_path(self) -> str:
        return self.input + (self.backup or "")


# Lengths and locks


METRES = {
    "nm": (1, 10**9),
    "um": (1, 10**6),
    "mm": (1, 1000),
    "cm": (1, 100),
    "dm": (1, 10),
    "m": (1, 1),
    "km": (1000, 1),
    "mil": (254, 10**7),
    "in": (254, 10**4),
    "ft": (3048, 10**4),
    "yd": (9144, 10**4),
}
"""Length units in metres, as numerator and denominator; ``mil`` is a thousandth of an inch."""

# Micro sign and Greek letter.
_MICRO = ("\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m")

UNIT_PATTERN = "|".join(sorted((*METRES, *_MICRO), key=len, reverse=True))
"""A regular expression for the name of a unit."""

COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
"""Comparisons that a user may write between a quantity and a length or number."""


def in_file_units(number: str, unit: str, file_unit: str | None, label: str = "") -> float:
    """A length in the unit of the file.

    Parameters
    ----------
    number : the length as text, so that 0.1 is a tenth and not the double next to it.
    unit : its unit, as in ``UNIT_PATTERN``.
    file_unit : the unit of the file's coordinates, one of ``METRES``.
    label : the beginning of a message.

    Raises UsageError if the file's unit is not known, or the length is too long for a double.
    """
    if file_unit is None:
        raise UsageError(
            f"{label}{number}{unit}: mesh files have no unit, so that it is not known how long "
            "that is",
            hint="say with --unit what the unit of the files is, such as --unit mm, or write the "
            f"length in file units (0.05){' or mean edge lengths (0.3e)' * ('lock' not in label)}",
        )
    from fractions import Fraction

    if not float(number):
        # ``0e1000000000`` would become a fraction with a billion digits.
        return 0.0
    own, other = METRES["um" if unit in _MICRO else unit], METRES[file_unit]
    try:
        return float(Fraction(number) * Fraction(*own) / Fraction(*other))
    except OverflowError:
        raise UsageError(f"{label}{number}{unit}: the length is too large") from None


BOUNDARY = "boundary"
AXES = ("x", "y", "z")

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LENGTH = re.compile(rf"(?a)\s*({_NUMBER})\s*(e|{UNIT_PATTERN})?\s*")
_LOCK = re.compile(rf"(?a)\s*([^\s<>=!]+)\s*(<=|>=|==|!=|<|>)\s*({_NUMBER})\s*({UNIT_PATTERN})?\s*")


@dataclass(frozen=True)
class Length:
    """A length above 0 in file units, or ``in_edges``: in mean edge lengths of the input."""

    value: float
    in_edges: bool

    def __str__(self) -> str:
        return f"{self.value!r}{'e' if self.in_edges else ''}"

    def in_units(self, mean_edge_length: float) -> float:
        return self.value * mean_edge_length if self.in_edges else self.value


@dataclass(frozen=True)
class Lock:
    """A vertex property, or a coordinate, compared with a value, such as ``confidence < 0.2``."""

    name: str
    comparison: str
    value: float

    def __str__(self) -> str:
        return f"{self.name} {self.comparison} {self.value!r}"


def parse_length(text: str, option: str = "--max-move", unit: str | None = None) -> Length:
    """Parse ``0.3e``, ``0.05``, or ``0.01mm`` where the files' ``unit`` is known; UsageError, which
    names the option, for anything else."""
    match = _LENGTH.fullmatch(text)
    value = float(match[1]) if match else 0.0
    if match is not None and 0.0 < value < math.inf and match[2] not in (None, "e"):
        value = in_file_units(match[1], match[2], unit, f"{option} ")
    if match is None or not 0.0 < value < math.inf:
        raise UsageError(
            f"{option} {text}: this is no length above 0",
            hint="write 0.3e for mean edge lengths, or 0.05 for file units; with --unit mm, if "
            "that is the unit of the files, also 0.01mm or 0.002in",
        )
    return Length(value, match[2] == "e")


def parse_lock(text: str, option: str = "--lock", unit: str | None = None) -> Lock | None:
    """Parse ``confidence < 0.2``, or ``z < 5mm`` where the files' ``unit`` is known; None for the
    word ``boundary``; UsageError, which names the option, for anything else."""
    if text.strip() == BOUNDARY:
        return None
    match = _LOCK.fullmatch(text)
    is_length = match is not None and match[4] is not None
    if match is None or not math.isfinite(float(match[3])) or (is_length and match[1] not in AXES):
        raise UsageError(
            f"{option} {text}: this is neither 'boundary' nor a property compared with a number",
            hint=f"as in {option} 'confidence < 0.2'; msal info lists a file's properties",
        )
    value = in_file_units(match[3], match[4], unit, f"{option} ") if is_length else float(match[3])
    return Lock(match[1], match[2], value)


# Settings from options and arguments


Check = Callable[[Any, str, str | None], Any]
"""Takes a value, its label for messages and the unit of the files; returns the setting."""

Assignment = tuple[str, str, Any]
"""The label of a method's parameter for messages, its name or symbol, and its value."""


def _refuse(label: str, value: object, allowed: str) -> NoReturn:
    raise UsageError(f"{label} = {value!r} is not allowed", hint=f"allowed: {allowed}")


def _word_of(words: Any) -> Check:
    def check(value: Any, label: str, unit: str | None) -> str:
        if value not in get_args(words):
            _refuse(label, value, " | ".join(get_args(words)))
        return str(value)

    return check


def _strength(value: Any, label: str, unit: str | None) -> float:
    number = to_number(value, label)
    if not -2.0 <= number <= 2.0:
        _refuse(label, value, "-2 to 2")
    return number


def _length(value: Any, label: str, unit: str | None) -> str:
    """A length as settings have it: ``"0.3e"`` in mean edge lengths, a number in file units."""
    text = value if isinstance(value, str) else repr(to_number(value, label))
    return str(parse_length(text, label, unit))


def _locks(value: str | Sequence[str], label: str, unit: str | None) -> tuple[str, ...]:
    return tuple(str(parse_lock(text, label, unit) or BOUNDARY) for text in to_texts(value, label))


def _field_names(value: Sequence[str], label: str, unit: str | None) -> tuple[str, ...]:
    from msal_cli.job.fields import KINDS

    for name in value:
        if name not in KINDS:
            raise UsageError(
                f"there is no field {name!r}", hint=f"the fields are: {', '.join(KINDS)}"
            )
    return tuple(dict.fromkeys(value))


def parse_input_format(value: str, label: str = "--format", unit: str | None = None) -> str:
    """A format that can be read, without a leading dot; UsageError for any other."""
    from msal_cli.codecs.detection import READABLE

    return parse_format(value, label, READABLE)


def _output_format(value: str, label: str, unit: str | None) -> str:
    from msal_cli.codecs.detection import WRITABLE

    return parse_format(value, label, WRITABLE)


_CHECKS: dict[str, Check | None] = {
    "keep": _word_of(Keep),
    "strength": _strength,
    "assume": _word_of(Assumption),
    "max_move": _length,
    "lock": _locks,
    "weights": lambda value, label, unit: (
        value if isinstance(value, str) else _refuse(label, value, "the name of a property")
    ),
    "despike": None,
    "min_noise": lambda value, *more: NEGLIGIBLE if value == NEGLIGIBLE else _length(value, *more),
    "to": _output_format,
    "encoding": _word_of(Encoding),
    "precision": _word_of(Precision),
    "strict": None,
    "format": parse_input_format,
    "fields": _field_names,
    "tile_set": None,
    "unit": None,
}
"""The options besides a method and its parameters, by their names in the Python API, each with the
check of its value; None accepts any value."""

_WISHES = ("keep", "strength", "assume")


def parse(given: Mapping[str, Any], *, as_options: bool = False) -> Settings:
    """Parse the options of a command, or the arguments of a function of the API.

    Parameters
    ----------
    given : values by the names of ``_CHECKS``, with None for what is not given; and ``method``,
        its ``parameters`` (assignments) and ``intersections``.  Other names are ignored.
    as_options : messages name options; by default arguments.

    Raises UsageError for values that are not allowed, or do not go together.
    """

    def label(name: str) -> str:
        return f"--{name.replace('_', '-')}" if as_options else name

    unit = given.get("unit")
    values = {
        name: check(given[name], label(name), unit) if check else given[name]
        for name, check in _CHECKS.items()
        if given.get(name) is not None
    }
    wishes = {name: values.pop(name) for name in _WISHES if name in values}
    method, parameters = _choose_method(given.get("method"), given["parameters"], wishes, label)
    if "weights" in values and method not in CHOOSING:
        from msal_cli import methods

        # Trust has no effect without a pull back to the scanned positions.
        if not methods.find(method).has_data_term(parameters):
            raise UsageError(
                f"{label('weights')}: a pull to the scanned positions is needed, and {method} has "
                "none as it is set",
                hint="choose msal, or a schedule other than plain where the method has schedules",
            )
    checks = (SELF_INTERSECTIONS,) if given.get("intersections") else ()
    return Settings(method, parameters, checks=checks, **values)


def _choose_method(
    method: str | None,
    assignments: Sequence[Assignment],
    wishes: Mapping[str, Any],
    label: Callable[[str], str],
) -> tuple[str, dict[str, Any]]:
    """A method's name and all its parameters, or one of ``CHOOSING`` and the wishes."""
    is_adaptive = method == ADAPTIVE or (method is None and not assignments)
    needs_all = wishes.get("keep") in ("edges", "shape")
    if method == AUTO or (method is None and needs_all):
        choice = AUTO
    elif not needs_all and (is_adaptive or (wishes and method is None)):
        choice = ADAPTIVE
    elif wishes:
        what = "a choice among all methods" if method == ADAPTIVE else "the automatic choice"
        raise UsageError(
            f"{', '.join(map(label, wishes))}: this is for {what}, and the method is {method!r}",
            hint="leave the method out; a parameter of a method that has this name is given among "
            "its parameters",
        )
    else:
        from msal_cli import methods

        found = methods.find("msal" if method is None else method)
        return found.name, resolve_parameters(found, assignments)
    if assignments:
        raise UsageError(
            f"{', '.join(name for _, name, _ in assignments)}: {choice!r} chooses the parameters "
            "itself",
            hint="give a method, such as 'msal', or leave the parameters out",
        )
    if choice == ADAPTIVE:
        return ADAPTIVE, {name: wish for name, wish in wishes.items() if wish}
    from msal_cli.auto import Wishes

    return AUTO, {**dataclasses.asdict(Wishes()), **wishes}


def resolve_parameters(method: Method, assignments: Iterable[Assignment]) -> dict[str, Any]:
    """All parameters of ``method``: the values that the user gave, and defaults for the rest.

    Raises UsageError for an unknown name, a value that is not allowed, or one parameter with two
    values.
    """
    values: dict[str, Any] = {}
    labels: dict[str, str] = {}
    for label, name, given in assignments:
        spec = method.spec(name)
        value = spec.validate(given)
        if values.setdefault(spec.name, value) != value:
            raise UsageError(
                f"{labels[spec.name]} and {label} give {spec.name} two different values",
                hint="give it once",
            )
        labels.setdefault(spec.name, label)
    return method.validate(values)


def parse_format(text: str, label: str, known: Sequence[str]) -> str:
    """A format as ``known`` spells it, without a leading dot; UsageError if it is none of them."""
    plain = str(text).lower().lstrip(".")
    if plain in known:
        return plain
    raise UsageError(
        f"{label} {text}: there is no such format", hint=f"known are: {', '.join(known)}"
    )


def to_number(value: Any, label: str) -> float:
    """A number; UsageError for anything else."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise UsageError(f"{label} is {value!r}, and must be a number") from None


def to_texts(texts: Any, label: str) -> tuple[str, ...]:
    """One text or several as a tuple; UsageError for anything else."""
    is_single = isinstance(texts, str | bytes) or not isinstance(texts, Iterable)
    listed = (texts,) if is_single else tuple(texts)
    for text in listed:
        if not isinstance(text, str):
            raise UsageError(f"{label}: {text!r} is not a text")
    return listed
