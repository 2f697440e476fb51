"""A motion with the estimates over time: one HTML file with a recording, that plays offline."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.framework import Context

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rows import row_family
from cpid_drake.estimation.smoothing import smooth
from cpid_drake.files.errors import InputError
from cpid_drake.identification.by_rows import complete_samples
from cpid_drake.identification.checked_log import in_joint_order
from cpid_drake.identification.result import Identification
from cpid_drake.logs.log import Log
from cpid_drake.logs.noise_estimation import estimate_suite
from cpid_drake.logs.screening import screen
from cpid_drake.report.live_server import LOCAL
from cpid_drake.report.scene import Scene
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.simulation import Simulation
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.scene_page import estimate_lines, scene_html
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD

LONGEST_REPLAY = 30.0
"""Longest part of a log that is replayed [s]: a page with more frames is slow to open."""

MOST_FRAMES = 240
"""Most frames of a replay; Meshcat interpolates between them."""

_MOST_SAMPLES = 600  # of each sensor, for the motion of a replay


def replay_html(
    spacecraft: Spacecraft,
    motion: Motion,
    estimates: Sequence[tuple[float, Identification]],
    *,
    truth: InertialParameters | None = None,
    visual_model: str | Path | None = None,
    title: str = "",
) -> str:
    """Return a self-contained page that replays a motion, with the numbers of the estimates.

    Args:
        spacecraft: the spacecraft model.
        motion: its motion.
        estimates: increasing times from which estimates are shown [s], and the estimates.
        truth: the true target, if it is known from a simulation.
        visual_model: model file with the true target's shape; default: an ellipsoid of its inertia.
        title: heading of the page.

    Raises:
        InputError: the motion has other joints than the spacecraft, or no samples; shapes of the
            model cannot be read.

    """
    if not len(motion):
        raise InputError("a replay needs samples")
    states, zero = spacecraft.to_states(motion), motion.time[0]
    meshcat = Meshcat(MeshcatParams(host=LOCAL))
    scene = Scene(spacecraft, meshcat, truth=truth, visual_model=visual_model)
    period = max(FRAME_PERIOD, (motion.time[-1] - zero) / MOST_FRAMES)
    meshcat.StartRecording(1 / period, set_visualizations_while_recording=False)
    starts = [time for time, _ in estimates]
    frames = np.arange(zero, motion.time[-1] + period, period)
    for k in np.unique(np.searchsorted(motion.time[:-1], frames - 1e-9)):
        latest = int(np.searchsorted(starts, motion.time[k] + 1e-9))
        estimate = estimates[latest - 1][1] if latest else None
        scene.draw(motion.time[k] - zero, states[k], estimate)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    steps = [(time - zero, estimate_text(estimate, truth)) for time, estimate in estimates]
    return scene_html(meshcat, steps, title=title, zero=zero)


def simulation_replay(
    simulation: Simulation, title: str, progress: Callable[[str], None] = lambda step: None
) -> tuple[str, Identification]:
    """Run a simulation; return its replay as a page, and the estimate at its end.

    Raises:
        InputError: the simulation fails.

    """
    scenario, estimates = simulation.scenario, list[tuple[float, Identification]]()
    end = scenario.simulation.duration

    def record(root_context: Context) -> None:
        now = root_context.get_time()
        progress(f"simulated {now:.1f} of {end:g} s")
        if now + 1e-9 >= max(0.25, end / 60) * (len(estimates) + 1):
            estimates.append((now, simulation.identification(root_context)))

    context = simulation.run(record)
    estimates.append((context.get_time(), simulation.identification(context)))
    page = replay_html(
        simulation.spacecraft,
        simulation.motion(context),
        estimates,
        truth=simulation.truth,
        visual_model=scenario.target.visual_model,
        title=title,
    )
    return page, estimates[-1][1]


def estimate_text(estimate: Identification, truth: InertialParameters | None = None) -> str:
    """Return an estimate as short lines of text, with half-widths of 95 % intervals."""
    lines = [f"from {estimate.sample_count} samples"]
    numbers = estimate_lines(estimate.parameters, np.diff(estimate.intervals)[:, 0] / 2, truth)
    if not np.isfinite(estimate.parameters).all():
        return f"{lines[0]}: {numbers[0]}"
    lines += numbers
    lines += [f"failed check: {failure}" for failure in estimate.failures]
    if estimate.inconsistencies:
        lines.append("no rigid body has the estimate; the nearest is drawn")
    return "\n".join(lines)


def motion_of(
    log: Log,
    spacecraft: Spacecraft,
    sensors: SensorSuite | None,
    longest: float = LONGEST_REPLAY,
) -> Motion:
    """Return the motion at the beginning of a log: complete samples, else smoothed ones.

    Of many samples, an even selection is used.

    Args:
        log: the samples.
        spacecraft: with the joints of the log.
        sensors: their errors; None estimates them.
        longest: length of the beginning [s].

    Raises:
        InputError: the log has too few samples, or a sensor that smoothing needs is missing.

    """
    beginning = log.between(0.0, longest).thinned(_MOST_SAMPLES)
    screened = screen(in_joint_order(beginning, spacecraft).log).log
    with_position = bool(len(screened.position))
    if len(screened.attitude):
        for rows in ("standard", *([] if with_position else ["relative"])):
            complete = complete_samples(screened, row_family(rows))
            if complete is not None:
                return complete
    suite = sensors or estimate_suite(screened)
    motion, _ = smooth(screened, suite, with_position=with_position)
    # A spline's rates at its ends are known from one side only; their noise looks like momentum.
    inner = np.arange(len(motion)).clip(1, max(len(motion) - 2, 1))
    return replace(motion, **{name: getattr(motion, name)[inner] for name in _RATES})


_RATES = ("v_WB", "w_WB", "qdot")
