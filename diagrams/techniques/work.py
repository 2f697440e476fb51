"""Processes that share the work of a study, and end with it."""

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import active_children, get_context
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

Inputs = TypeVar("Inputs")
Task = TypeVar("Task")
Result = TypeVar("Result")


def shared_work(
    prepare: Callable[[Inputs], Callable[[Task], Result]],
    inputs: Inputs,
    tasks: Sequence[Task],
    jobs: int,
) -> Iterator[Result]:
    """Yield the results of tasks in their order, from this process or from several others.

    Linear algebra has one thread in each: with small matrices, several only wait for each other.

    Args:
        prepare: returns the function of a task from the inputs; called once in every process. It
            must be importable.
        inputs: what all tasks share.
        tasks: the arguments of that function.
        jobs: number of processes; with one, the tasks are done in this process.

    """
    if jobs <= 1:
        with threadpool_limits(1, "blas"):
            yield from map(prepare(inputs), tasks)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), _start, (prepare, inputs)) as pool:
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # the processes inherit it
        results = [pool.submit(_work, task) for task in tasks]
        signal.signal(signal.SIGINT, handler)
        try:
            yield from (each.result() for each in results)
        except BaseException:  # also where the caller stops early, or an interrupt
            for process in active_children():
                process.terminate()
            raise


_function: Callable[[Any], Any] | None = None


def _start(prepare: Callable[[Any], Callable[[Any], Any]], inputs: Any) -> None:
    global _function
    threadpool_limits(1, "blas")
    _function = prepare(inputs)


def _work(task: Any) -> Any:
    assert _function is not None
    return _function(task)
