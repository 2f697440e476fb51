"""The exception for bad input, and texts of its messages."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches

MANY = 25
"""Number of choices that a message lists at most if one of them is close."""


class InputError(ValueError):
    """An input of the caller (model, scenario, data or option) cannot be used.

    The message is one line with the problem, its place and the remedy. The command line prints it
    unchanged and exits with code 2.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


@contextmanager
def prefix_errors(where: str) -> Iterator[None]:
    """Put the name of a file before the message of an InputError that is raised inside.

    Raises:
        InputError: the one raised inside, with `where` before its message.

    """
    try:
        yield
    except InputError as error:
        raise error if str(error).startswith(where) else InputError(f"{where}: {error}") from error


def listed(names: Sequence[str], most: int = 8) -> str:
    """Return the first names of a list, and how many follow."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def choose_from(name: object, choices: Iterable[str]) -> str:
    """Return the last part of the message for a wrong name: the closest choice, and all choices.

    If there are more than `MANY` choices, those that are not close are left out.
    """
    choices = list(choices)
    near = get_close_matches(str(name), choices, n=1)
    if near and len(choices) > MANY:
        return f"did you mean '{near[0]}'?"
    return (
        "".join(f"did you mean '{word}'? " for word in near) + f"choose from {', '.join(choices)}"
    )
