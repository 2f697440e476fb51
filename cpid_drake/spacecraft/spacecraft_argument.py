"""The check of a spacecraft that a caller gives."""

from pathlib import Path

from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft


def require_spacecraft(given: object) -> None:
    """Raise an InputError for what is no spacecraft, such as a path."""
    if isinstance(given, Spacecraft):
        return
    model = repr(str(given)) if isinstance(given, (str, Path)) else "model"
    raise InputError(
        f"the spacecraft must be a Spacecraft, not {given!r:.80}: a model alone does not say which "
        "body is the base and which frame holds the target; give "
        f"Spacecraft({model}, base=..., capture_frame=...)"
    )
