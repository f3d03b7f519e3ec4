"""The exit statuses of msal, all of them, and which one wins.

| 0 | every selected file is written or up to date |
| 1 | fatal: the only file failed, all failed, given up after --max-failures, the output cannot be
      written, an internal error |
| 2 | wrong use or configuration; nothing was touched |
| 3 | some files failed; the others are written and valid |
| 4 | all were processed, but a gate failed |
| 5 | nothing matched |
| 128 + n | ended by signal n: 130 for Ctrl-C, 143 for SIGTERM; finished files are whole |
| 141 | the reader of standard output went away, as `| head` does; no message |

2 and 5 come before any work.  After it, of several that apply, a signal wins over 1, then 3, then
4, then 0; of folders that are compared, a file without a partner (3) does not hide 4.
"""

from __future__ import annotations

from msal_cli.errors import MsalError, UsageError

SUCCESS = 0
FATAL = 1
USAGE = 2
SOME_FAILED = 3
GATE_FAILED = 4
NOTHING_MATCHED = 5
INTERRUPTED = 130
# As if by SIGPIPE, which is how `cat` and `git` end too: no success, and yet no failure of ours.
READER_GONE = 141

_RISING = (SUCCESS, GATE_FAILED, SOME_FAILED, FATAL)


def worst(first: int, second: int) -> int:
    """The one of two statuses that wins."""
    if first not in _RISING or second not in _RISING:
        # Signals, and refusals before any work, say more than what came of the work.
        return second if first in _RISING else first
    return max(first, second, key=_RISING.index)


def of_files(
    n_files: int, n_failed: int, *, is_gate_failed: bool = False, is_given_up: bool = False
) -> int:
    """The status of a run over ``n_files`` files that came to its end, or was given up."""
    if is_given_up:
        return FATAL
    if n_failed:
        return FATAL if n_failed == n_files else SOME_FAILED
    return GATE_FAILED if is_gate_failed else SUCCESS


def of_error(error: MsalError) -> int:
    """The status of a command that an error ended."""
    if error.code == "E_NOTHING_MATCHED":
        return NOTHING_MATCHED
    return USAGE if isinstance(error, UsageError) else FATAL


def of_interrupt(interrupt: KeyboardInterrupt) -> int:
    """The status after a signal: the one that ``batch.interrupts`` noted, or that of Ctrl-C."""
    return int(getattr(interrupt, "exit_status", INTERRUPTED))
