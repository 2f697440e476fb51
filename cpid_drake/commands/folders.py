"""Where commands write."""

import tempfile
from pathlib import Path

from cpid_drake.errors import InputError


def make_folder(path: Path) -> None:
    """Make the folder that --out names.

    Raises:
        InputError: it cannot be made or written to.

    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass  # a folder that cannot be written to is found out now, not after the work
    except OSError as error:
        raise InputError(f"--out {path}: cannot write there: {error.strerror}") from error
