"""Live views in the browser: of a simulation, of a log as if it were live, and of a ROS 2 node."""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, EventStatus
from rich.console import Console

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rotations import rotate_by_quaternion
from cpid_drake.files.errors import InputError
from cpid_drake.identification.description import describe
from cpid_drake.identification.result import Identification
from cpid_drake.online.messages import OK, Status
from cpid_drake.online.online_identifier import OnlineIdentifier
from cpid_drake.online.ros_samples import RosSamples
from cpid_drake.report.live_page import PERIOD, LivePage
from cpid_drake.report.scene import Scene
from cpid_drake.report.terminal import shown_live
from cpid_drake.simulation.simulation import Simulation
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD

STOP = "Stop"


def serve(simulation: Simulation, page: LivePage, rate: float) -> None:
    """Run a simulation as soon as a page is open; play its recording until Stop is clicked.

    Call this in the thread that opened the page. The rate is that of simulated to real time.

    Raises:
        InputError: the simulation fails; shapes of the model cannot be read.

    """
    meshcat, look = page.meshcat, simulation.scenario.target.visual_model
    scene = Scene(simulation.spacecraft, meshcat, truth=simulation.truth, visual_model=look)
    meshcat.AddButton(STOP)
    identifier, drawn = simulation.identifier, -np.inf
    monitor = page.monitor(identifier)

    def show(root_context: Context) -> EventStatus:
        nonlocal drawn
        now = root_context.get_time()
        if now - drawn > FRAME_PERIOD - 1e-9:
            drawn = now
            state = simulation.state(root_context)
            scene.draw(now, state, identifier.identification(root_context))
        monitor(root_context)
        if meshcat.GetButtonClicks(STOP):
            return EventStatus.ReachedTermination(simulation.diagram, "stopped")
        return EventStatus.DidNothing()

    while not meshcat.GetNumActiveConnections():
        time.sleep(PERIOD)
    meshcat.StartRecording(1 / FRAME_PERIOD)
    context = simulation.run(show, realtime_rate=rate)
    ended = "the recording plays until Stop"
    page.show(context.get_time(), simulation.identification(context), status=ended)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    while not meshcat.GetButtonClicks(STOP):
        time.sleep(PERIOD)


def show_replay(
    identifier: OnlineIdentifier,
    samples: Sequence[tuple[str, float, np.ndarray]],
    rate: float,
    console: Console,
    page: LivePage | None = None,
    drawn: tuple[Spacecraft, Motion] | None = None,
) -> Identification:
    """Feed samples to an identifier in real time, show its estimates, and return the last one.

    Args:
        identifier: the identifier.
        samples: (sensor, time [s], value) in the order of their times, as of `Log.messages`.
        rate: ratio of replayed to real time.
        console: where the estimates are printed.
        page: where they are shown; None for nowhere.
        drawn: what the page's scene shows; None for no scene.

    Raises:
        InputError: no port is free; shapes of the model cannot be read.

    """
    first, last = samples[0][1], samples[-1][1]
    scene, frames, states = None, np.zeros(1), np.zeros((1, 0))
    if page is not None and drawn is not None:
        spacecraft, motion = drawn
        frames, states = motion.time, spacecraft.to_states(motion)
        scene = Scene(spacecraft, page.meshcat)
    begin, shown, shown_frame = time.monotonic(), -np.inf, -np.inf
    estimate = identifier.estimate()

    def lag(stamp: float) -> float:
        """Return how late a sample of this stamp would be now [s]; negative before its time."""
        return time.monotonic() - begin - (stamp - first) / rate

    with shown_live(console) as screen:
        for count, (name, stamp, value) in enumerate(samples, start=1):
            time.sleep(max(-lag(stamp), 0.0))
            identifier.add(name, stamp, value)
            now = time.monotonic()
            if now - shown > PERIOD:
                estimate, shown = identifier.estimate(), now
                late = f"{max(lag(stamp), 0.0):.1f} s late"
                screen.update(
                    "\n".join([_state(estimate, stamp, count, late), *describe(estimate)])
                )
                if page is not None:
                    page.show(stamp - first, estimate, status=late)
            if scene and now - shown_frame > FRAME_PERIOD:
                shown_frame = now
                k = max(int(np.searchsorted(frames, stamp, side="right")) - 1, 0)
                scene.draw(stamp - first, states[k], estimate)
        estimate = identifier.finish()
        late = f"{lag(last):.1f} s late"
        screen.update(_state(estimate, last, len(samples), late))
    if page is not None:
        page.show(last - first, estimate, status=late)
    if scene:
        scene.draw(last - first, states[-1], estimate)
    return estimate


def _state(estimate: Identification, time: float, count: int, late: str) -> str:
    rejected = sum(estimate.rejected.values())
    return f"{time:.1f} s: {count} samples, {rejected} rejected; {late}"


class NodeView:
    """What a page shows of a ROS 2 node; see `ros2.View`.

    Args:
        samples: those of the node.
        spacecraft: the spacecraft model.
        page: the page.

    Raises:
        InputError: no port is free; shapes of the model cannot be read.

    """

    def __init__(self, samples: RosSamples, spacecraft: Spacecraft, page: LivePage) -> None:
        self._samples, self._spacecraft, self._page = samples, spacecraft, page
        self._scene = Scene(spacecraft, page.meshcat)
        self._estimate: Identification | None = None
        self._begin, self._drawn = time.monotonic(), -np.inf

    def show(self, estimate: Identification, rows: Sequence[Status]) -> None:
        """Show an identification, and what is wrong with topics and stream."""
        newest, until, self._estimate = self._samples.newest, self._samples.stamp, estimate
        behind = f"estimate {(newest - until) / 1e9:.1f} s behind" if until else ""
        problems = [f"{row.name}: {row.text}" for row in rows if row.level != OK]
        for row in rows:
            if count := row.values.get("unusable"):
                problems.append(f"{row.name}: {count} messages cannot be used")
        now = newest / 1e9 if newest else np.nan
        self._page.show(now, estimate, status=behind, problems=problems)

    def draw(self) -> None:
        """Draw the spacecraft at the latest samples, if they are new to the eye."""
        now = time.monotonic() - self._begin
        if now - self._drawn < FRAME_PERIOD:
            return
        self._drawn = now
        with suppress(InputError):  # a sample that is no number or no rotation
            state = state_of(self._spacecraft, self._samples.latest)
            if state is not None:
                self._scene.draw(now, state, self._estimate)


def state_of(spacecraft: Spacecraft, latest: Mapping[str, ArrayLike]) -> Array | None:
    """Return the state x = [q; v] (nx,) at the latest samples; None without encoders.

    What no sensor measures is zero; so are all rates, if one of them is not measured, since parts
    of them have another momentum.

    Args:
        spacecraft: the spacecraft model.
        latest: the latest value by sensor.

    Raises:
        InputError: a value is not finite, or a quaternion is none.

    """
    if "encoders" not in latest:
        return None
    still, joints = np.zeros(3), spacecraft.joint_names
    values = {"attitude": [1.0, 0.0, 0.0, 0.0], "position": still, **latest}
    if not {"gyro", "velocity", "joint_rates"} <= latest.keys():
        values |= {"gyro": still, "velocity": still, "joint_rates": np.zeros(len(joints))}
    rows = {name: np.array([value], dtype=float) for name, value in values.items()}
    with np.errstate(divide="ignore", invalid="ignore"):  # `Motion` refuses what is no quaternion
        w_WB = rotate_by_quaternion(rows["attitude"], rows["gyro"])
    base = rows["attitude"], rows["position"], w_WB, rows["velocity"]
    motion = Motion(joints, np.zeros(1), *base, rows["encoders"], rows["joint_rates"])
    return np.asarray(spacecraft.to_states(motion)[0])
