"""How many threads linear algebra has."""

import threading
from contextlib import ContextDecorator
from functools import cache

from threadpoolctl import ThreadpoolController


class OneThread(ContextDecorator):
    """Limits linear algebra to one thread: with small matrices, several only wait for each other.

    NumPy and SciPy have libraries of their own, which are limited both. The limit ends with the
    last of the functions that run in it, in whatever thread.
    """

    def __init__(self) -> None:
        self._lock, self._depth = threading.Lock(), 0

    def __enter__(self) -> None:
        with self._lock:
            if not self._depth:
                self._limited = _libraries().limit(limits=1, user_api="blas")
            self._depth += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._depth -= 1
            if not self._depth:
                self._limited.restore_original_limits()


@cache
def _libraries() -> ThreadpoolController:
    """Return the libraries; to find them takes longer than to solve a block."""
    return ThreadpoolController()


one_thread = OneThread()
