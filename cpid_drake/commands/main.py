"""The `cpid` command: its end, also after an interrupt."""

import gc
import os
import signal
import sys
import threading
import time
from functools import cache
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_GRACE = 1.5  # [s] for a tidy end, after which the process ends in any case


def main() -> None:
    """Run `cpid` and exit; an error or an interrupt causes one line on stderr.

    A process that is asked to terminate ends in the same way as after Ctrl-C.
    """
    is_interrupted = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal is_interrupted
        is_interrupted = True
        _silence_libraries()
        raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in _SIGNALS}
    try:
        for number in _SIGNALS:
            if before[number] is not signal.SIG_IGN:
                signal.signal(number, interrupt)
        signal.set_wakeup_fd(_watch(), warn_on_full_buffer=False)
        from cpid_drake.commands.app import run

        code = run()
    except BaseException:  # libraries turn an interrupt into other errors, such as ImportError
        if not is_interrupted:
            raise
    finally:
        signal.set_wakeup_fd(-1)
        for number, handler in before.items():
            signal.signal(number, handler)
    if is_interrupted:
        gc.collect()  # removes semaphores of process pools
        _end()
    sys.exit(code)


@cache
def _watch() -> int:
    """Start a thread that ends the process soon after an interrupt; return the file to notify it.

    Python handles an interrupt only between its own instructions, and a library may run long.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def watch() -> None:
        while os.read(reading, 1)[0] not in _SIGNALS:
            pass
        time.sleep(_GRACE)
        _end()

    threading.Thread(target=watch, daemon=True).start()
    return writing


@cache
def _silence_libraries() -> int:
    """Send standard error nowhere, and return another file for the last line.

    Libraries write lines of their own about an interrupt, for example Drake while it is imported.
    """
    error = os.dup(sys.stderr.fileno())
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
    return error


def _end() -> NoReturn:
    """End the process without waiting for threads of libraries."""
    os.write(_silence_libraries(), b"cpid: interrupted\n")
    os._exit(INTERRUPTED)
