"""Processes that share the work of a command, and end with it."""

import os
import pickle
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ContextDecorator
from functools import cache
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
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
    # The inputs are in a file: a start with large arguments waits for the process to read them.
    with (
        tempfile.NamedTemporaryFile() as file,
        ProcessPoolExecutor(jobs, get_context("spawn"), _start, (file.name,)) as pool,
    ):
        pickle.dump((prepare, inputs), file)
        file.flush()
        try:
            results = [pool.submit(_work, task) for task in tasks]
            for result in results:
                yield result.result()
        except BaseException:  # also where the caller stops early, or an interrupt
            for process in active_children():
                process.terminate()
            raise


_function: Callable[[Any], Any] | None = None


def _start(file: str) -> None:
    """Prepare a process from the file with its inputs."""
    global _function
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process ends this one
    threading.Thread(target=end_with_parent, daemon=True).start()
    prepare, inputs = pickle.loads(Path(file).read_bytes())  # imports NumPy and SciPy
    one_thread.__enter__()
    _function = prepare(inputs)


def _work(task: Any) -> Any:
    assert _function is not None
    return _function(task)


def end_with_parent() -> None:
    """End this process when the main process has ended, even if it was killed."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
