"""The Python API: the names of ``import msal_cli``, which its ``__all__`` lists.

Functions take numpy arrays, objects of other mesh libraries, or paths.  They print nothing; the
log goes to the logger ``msal``.  Errors are those of ``msal_cli.errors``.
"""

# ruff: noqa: F403
import logging

from msal_cli.api.denoise import *
from msal_cli.api.measure import *
from msal_cli.api.method_list import *
from msal_cli.batch.inputs import *
from msal_cli.errors import *
from msal_cli.job.records import *

# Without a handler Python would print warnings to standard error.
logging.getLogger("msal").addHandler(logging.NullHandler())
