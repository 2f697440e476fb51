"""Which scenario an error is about."""

from collections.abc import Iterator
from contextlib import contextmanager

from cpid_drake.errors import InputError


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Let what is wrong with a scenario that has been loaded say which scenario it is.

    Raises:
        InputError: the one raised inside, with `where` before it.

    """
    try:
        yield
    except InputError as error:
        raise error if str(error).startswith(where) else InputError(f"{where}: {error}") from error
