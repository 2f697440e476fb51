"""A page that shows an identification while it runs: estimate, residuals and problems over time."""

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from plotly.offline import get_plotlyjs
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.framework import Context

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.files.digits import significant, with_half_width
from cpid_drake.files.errors import InputError
from cpid_drake.identification.result import Identification
from cpid_drake.report.live_history import START, LiveHistory, Place
from cpid_drake.report.live_server import LOCAL, LiveServer
from cpid_drake.systems.identifier import Identifier
from cpid_drake.systems.scene_page import wait_for_enter

PERIOD = 0.2
"""Time between two points of the curves [s]: fast enough for the eye."""

_PAGE = Path(__file__).with_name("templates") / "live.html"
_STAYS = "The run has ended. The page stays until the command is closed."
_ENDED = "The run has ended, and the scene with it: these are the last values."
_ZOOM = 0.75  # of the camera: the scene is as high as it is wide
_DIGITS = 10  # of numbers in curves


class LivePage:
    """A page in the browser that shows an identification while it runs.

    It has the ten parameters with their 95 % intervals over time, the residuals, failed checks and
    other problems as text, and a scene in Meshcat, if one is drawn. The page needs no network. The
    run goes on without a browser, and one that is opened later shows everything so far. Memory is
    bounded: points of a long run are thinned.

    As a context manager it ends with its block.

    Args:
        title: heading of the page.
        host: address on which page and scene are served: this computer alone by default, all of its
            networks with "0.0.0.0".
        truth: the true target; simulation only.

    Raises:
        InputError: no port is free, or the host is no address of this computer.

    """

    def __init__(
        self,
        title: str = "Live identification",
        *,
        host: str = LOCAL,
        truth: InertialParameters | None = None,
    ) -> None:
        self._host, self._lock, self._history = host, Lock(), LiveHistory()
        self._state: dict[str, Any] = {
            "title": title,
            "names": PARAMETER_NAMES,
            "units": PARAMETER_UNITS,
            "truth": None if truth is None else _row(truth.to_vector()),
            "scene": None,
            "end": "",
            "isClosed": False,
        }
        served = {
            "/": ("text/html; charset=utf-8", _PAGE.read_bytes()),
            "/plotly.min.js": ("text/javascript; charset=utf-8", get_plotlyjs().encode()),
        }
        self._server = LiveServer(host, served, self._events)
        print(f"Open {self.address}", file=sys.stderr, flush=True)

    @property
    def address(self) -> str:
        """Address of the page."""
        return self._server.address

    @cached_property
    def meshcat(self) -> Meshcat:
        """The scene beside the curves; the page has none before it is asked for.

        Raises:
            InputError: no port is free.

        """
        try:
            meshcat = Meshcat(MeshcatParams(host=self._host, show_stats_plot=False))
        except RuntimeError as error:
            raise InputError(f"Meshcat cannot be opened: {error}") from error
        meshcat.SetProperty("/Cameras/default/rotated/<object>", "zoom", _ZOOM)
        self._change(scene=meshcat.port())
        return meshcat

    def show(
        self,
        time: float,
        estimate: Identification,
        *,
        status: str = "",
        problems: Iterable[str] = (),
    ) -> None:
        """Show an identification; it may be the same as before.

        Args:
            time: until which there are samples [s]; NaN before the first. An earlier one than
                before begins the curves anew.
            estimate: the identification.
            status: how the run does, such as "0.3 s late".
            problems: sentences besides failed checks, rejected samples and warnings.

        """
        bounds = estimate.intervals
        point = [time, _row(estimate.parameters), _row(bounds[:, 0]), _row(bounds[:, 1])]
        text = json.dumps([*point, _residuals(estimate)])
        rejected = {name: count for name, count in estimate.rejected.items() if count}
        many = ", ".join(f"{count} of {name}" for name, count in rejected.items())
        now = "no samples yet"
        with self._lock:
            if np.isfinite(time):
                self._history.add(time, text)
                now = f"{time:.1f} s"
            self._state |= {
                "status": "; ".join(each for each in (now, status) if each),
                "samples": f"{estimate.sample_count} samples, {sum(rejected.values())} rejected",
                "verdict": _verdict(estimate),
                "passed": estimate.passed,
                "answer": estimate.explain(),
                "numbers": _numbers(estimate),
                "residuals": "σ" if estimate.sensors is not None else "units of the rows",
                "problems": [
                    *(f"Failed check: {text}" for text in estimate.failures),
                    *problems,
                    *([f"Rejected samples: {many}"] if many else []),
                    *(f"Warning: {text}" for text in estimate.warnings),
                ],
            }
        self._server.notify()

    def monitor(
        self, identifier: Identifier, *, period: float = PERIOD
    ) -> Callable[[Context], None]:
        """Return a monitor for Drake's `Simulator`, which shows an identifier of its Diagram.

        Args:
            identifier: in the Diagram.
            period: simulated time between points [s].

        """
        shown = -np.inf

        def show(root_context: Context) -> None:
            nonlocal shown
            now = root_context.get_time()
            if not shown <= now < shown + period - 1e-9:
                shown = now
                self.show(now, identifier.identification(root_context))

        return show

    def close(self, *, wait: bool = False) -> None:
        """End the page; browsers that show it keep its last values, and say that it has ended.

        Args:
            wait: keep page and scene open until Enter or Ctrl-C.

        """
        if self._state["isClosed"]:
            return
        if wait:
            self._change(end=_STAYS)
            wait_for_enter(self.address)
        self._change(end=_ENDED, isClosed=True)
        self._server.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _change(self, **state: Any) -> None:
        with self._lock:
            self._state |= state
        self._server.notify()

    def _events(self, place: Place | None) -> tuple[Place, str]:
        """Return the state, and the points since a place."""
        with self._lock:
            place, valid, points = self._history.since(START if place is None else place)
            state = json.dumps(self._state)
        return place, f'{{"valid":{valid},"points":[{",".join(points)}],"state":{state}}}'


def _number(value: float) -> float | None:
    """Return a number for JSON, which has no NaN."""
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None


def _row(values: ArrayLike) -> list[float | None]:
    return [_number(value) for value in np.asarray(values, dtype=float)]


def _residuals(estimate: Identification) -> dict[str, float | None]:
    """Return the root mean square of residuals by sensor, or of the rows of states."""
    sizes = {
        name: float(np.sqrt(np.mean(each.value**2)))
        for name, each in estimate.residuals.items()
        if each.value.size
    }
    if not sizes and estimate.solution is not None and np.isfinite(estimate.solution.residual_rms):
        sizes = {"rows": estimate.solution.residual_rms}
    return {name: _number(size) for name, size in sizes.items()}


def _numbers(estimate: Identification) -> Sequence[str]:
    """Return each parameter with the half-width of its 95 % interval."""
    halves = np.diff(estimate.intervals)[:, 0] / 2
    texts = []
    for value, half, unit in zip(estimate.parameters, halves, PARAMETER_UNITS):
        text = with_half_width(value, half)
        if "e" in text:  # from exact states: all digits would not be readable
            text = f"{significant(value, 7)} ± {significant(half)}"
        texts.append(f"{text} {unit}" if np.isfinite(value) else "not identifiable")
    return texts


def _verdict(estimate: Identification) -> str:
    """Return how the checks ended, in words."""
    if estimate.failures:
        count = len(estimate.failures)
        return "a check failed" if count == 1 else f"{count} checks failed"
    return "all checks passed" if estimate.checks else "no checks yet"
