"""Names of estimators in earlier versions, which files and callers may still use.

This module imports nothing heavy: the command line reads it before it does any work.
"""

import sys
import warnings

FORMER_NAMES = {"momentum_filter": "recursive_fit"}
"""Current names of estimators by former names."""


class FormerNameWarning(DeprecationWarning):
    """A former name was used, which the next version will refuse.

    The command line prints the message.
    """


def current_estimator(name: str) -> str:
    """Return the current name of an estimator, with a `FormerNameWarning` for a former name.

    The warning names the line that called this package.
    """
    if name not in FORMER_NAMES:
        return name
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("cpid_drake."):
        frame, level = frame.f_back, level + 1
    warnings.warn(
        f"estimator '{name}' is now named '{FORMER_NAMES[name]}'; the next version will refuse "
        f"'{name}'",
        FormerNameWarning,
        stacklevel=level,
    )
    return FORMER_NAMES[name]
