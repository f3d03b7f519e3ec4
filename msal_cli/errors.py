"""Every error a user can meet, one class per fault.

    MsalError
    |-- UsageError          the command is wrong; nothing was touched
    |   `-- MissingInputError   there is no such file or folder (also a FileNotFoundError)
    |-- InputError          the file is at fault
    |   |-- FormatError         it is not what its format says
    |   |-- TruncatedError      it is shorter than its own counts say
    |   |-- ContentError        it parses, but holds a mesh that cannot be denoised
    |   |-- UnsupportedError    a format, or a feature of one, that is not read or written
    |   |-- MissingFileError    it does not exist when it is read (also a FileNotFoundError)
    |   `-- TooLargeError       a limit against hostile or oversized input was hit
    |-- LossError           a conversion would lose data and --strict forbids it
    |-- OutputError         the output cannot be written
    |-- ResourceError       the worker crashed, ran out of memory or out of time
    `-- InternalError       a check on our own result failed: a defect of msal

``batch`` adds NothingMatched (no input file is selected; exit status 5).

An error has a stable ``code``, a message, ``where`` it is in the file (element, index or line),
a ``hint`` on what to do, and the ``path``.  Only ``cli`` prints it and sets an exit status.
"""

EXPORT_AGAIN = "the file is damaged; export it again"
"""The hint for a file whose own counts or indices contradict each other."""

CUT_SHORT = "the file was cut short; copy or export it again"
"""The hint for a file that ends too early."""


class MsalError(Exception):
    """Base of all errors; ``str(error)`` is the message alone.

    Parameters
    ----------
    message : what is wrong and why, one sentence without a full stop.
    where : the place in the file, such as ``"vertex 17"`` or ``"line 204"``.
    hint : what the user can do about it; by default the ``usual_hint`` of the class.
    path : the file; set later where the reader does not know it.
    code : replaces the code of the class.
    """

    code = "E_INTERNAL"
    usual_hint = ""

    def __init__(
        self, message: str, *, where: str = "", hint: str = "", path: str = "", code: str = ""
    ) -> None:
        super().__init__(message)
        self.message = message
        self.where = where
        self.hint = hint or self.usual_hint
        self.path = path
        if code:
            self.code = code


class UsageError(MsalError):
    """Wrong use or configuration, or another run at work (``E_LOCKED``); raised before any work."""

    code = "E_USAGE"


class MissingInputError(UsageError, FileNotFoundError):
    """There is no such file or folder; raised before any work."""


class InputError(MsalError):
    """The input file is at fault."""

    code = "E_INPUT"


class FormatError(InputError):
    """The file is not what its format says."""

    code = "E_FORMAT"
    usual_hint = EXPORT_AGAIN


class TruncatedError(InputError):
    """The file is shorter than its own counts say."""

    code = "E_TRUNCATED"


class ContentError(InputError):
    """The file parses but its mesh cannot be used.

    Codes: ``E_NONFINITE`` (NaN or infinite position), ``E_INDEX`` (a face names a vertex that is
    not there), ``E_NO_FACES``, ``E_RANGE`` (coordinates too large or too small to compute with).
    """

    code = "E_CONTENT"


class UnsupportedError(InputError):
    """A format, or a feature of one, that is not read or written."""

    code = "E_UNSUPPORTED"
    usual_hint = "convert it to PLY"


class MissingFileError(InputError, FileNotFoundError):
    """The file does not exist when it is read."""

    code = "E_READ"


class TooLargeError(InputError):
    """A limit against hostile or oversized input was hit."""

    code = "E_TOO_LARGE"


class LossError(MsalError):
    """A conversion would lose data and ``--strict`` forbids it."""

    code = "E_LOSS"


class OutputError(MsalError):
    """The output cannot be written."""

    code = "E_WRITE"


class ResourceError(MsalError):
    """A worker crashed (``E_CRASH``), or memory (``E_MEMORY``) or time (``E_TIMEOUT``) ran out."""

    code = "E_CRASH"


class InternalError(MsalError):
    """A check on our own result failed; please report it."""


EXTRAS = {"cloud": "fsspec gcsfs s3fs", "dask": "distributed"}
"""The packages of extras, for messages."""


def install_hint(extra: str) -> str:
    """The hint for a missing package of an extra, such as ``msal-cli[cloud]``.

    It names the packages, because ``pip install msal-cli[cloud]`` fails where msal was installed
    from a checkout or a wheel and no index has it.
    """
    return f"pip install {EXTRAS[extra]} (that is msal-cli[{extra}])"


def damaged(message: str, where: str = "") -> FormatError:
    return FormatError(message, where=where)


def other_format(message: str, where: str, suffix: str) -> FormatError:
    return FormatError(message, where=where, hint=f"is it another format under a .{suffix} name?")


def cut_short(message: str, where: str = "") -> TruncatedError:
    return TruncatedError(message, where=where, hint=CUT_SHORT)


def bad_index(message: str, where: str) -> ContentError:
    return ContentError(message, where=where, hint=EXPORT_AGAIN, code="E_INDEX")


def not_finite(message: str, where: str) -> ContentError:
    hint = "remove the vertex and its faces, or export the file again"
    return ContentError(message, where=where, hint=hint, code="E_NONFINITE")


def no_faces(message: str, where: str = "", hint: str = "") -> ContentError:
    hint = hint or "msal denoises surfaces; this file has none"
    return ContentError(message, where=where, hint=hint, code="E_NO_FACES")


def format_count(number: int | None, singular: str, plural: str = "") -> str:
    """``1 file``, ``1,200 vertices``; empty for None."""
    if number is None:
        return ""
    usual = f"{singular}s".replace("vertexs", "vertices").replace("hedrons", "hedra")
    return f"{number:,} {singular if number == 1 else plural or usual}"
