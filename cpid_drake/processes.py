"""Processes that share the work of a command, and end with it."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ContextDecorator
from functools import cache
from multiprocessing import get_context
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

Inputs = TypeVar("Inputs")
Task = TypeVar("Task")
Result = TypeVar("Result")


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


def shared_work(
    prepare: Callable[[Inputs], Callable[[Task], Result]],
    inputs: Inputs,
    tasks: Sequence[Task],
    jobs: int,
) -> Iterator[Result]:
    """Yield the results of tasks in their order, from this process or from several others.

    Args:
        prepare: returns the function of a task from the inputs; called once in every process. It
            must be importable.
        inputs: what all tasks share.
        tasks: the arguments of that function.
        jobs: number of processes; with one, the tasks are done in this process.

    """
    if jobs <= 1:
        with one_thread:
            yield from map(prepare(inputs), tasks)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), _start, (prepare, inputs)) as pool:
        try:
            yield from pool.map(_work, tasks)
        except BaseException:  # also where the caller stops early, or an interrupt
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_function: Callable[[Any], Any] | None = None


def _start(prepare: Callable[[Any], Callable[[Any], Any]], inputs: Any) -> None:
    global _function
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # an interrupt ends this process without a word
    one_thread.__enter__()
    _function = prepare(inputs)


def _work(task: Any) -> Any:
    assert _function is not None
    return _function(task)
