"""Commands of several commands."""

from math import inf
from typing import Any

from cyclopts import App, Group, Parameter


def group(name: str, **others: Any) -> App:
    """Return a command of several commands, which add themselves to it."""
    return App(
        name,
        default_parameter=Parameter(
            negative=(),
            allow_repeating=True,  # the last one counts
            show_default=lambda value: None if isinstance(value, bool) or value == inf else value,
        ),
        group_parameters=Group.create_default_parameters("Options"),
        **others,
    )
