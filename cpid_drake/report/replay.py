"""A recording with the estimates over time: one HTML file that plays offline."""

import json
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.motion import Motion
from cpid_drake.errors import InputError
from cpid_drake.identification.result import Identification
from cpid_drake.scenario.schema import Scenario
from cpid_drake.scenario.simulation import make_simulation
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.scene_visualizer import (
    FRAME_PERIOD,
    LEGEND,
    SceneVisualizer,
    add_bodies,
    can_be_drawn,
    open_meshcat,
)

_OVERLAY = Path(__file__).with_name("replay_overlay.html")

MOST_FRAMES = 640
"""Largest number of frames of a replay; in longer logs they are over `FRAME_PERIOD` apart."""


def replay_html(
    spacecraft: Spacecraft,
    telemetry: Motion,
    estimates: Sequence[tuple[float, Identification]],
    *,
    truth: InertialParameters | None = None,
    visual_model: str | Path | None = None,
    title: str = "",
) -> str:
    """Return a self-contained page that replays a motion with the estimates over time.

    Args:
        spacecraft: the known spacecraft. Bodies whose shapes cannot be read are not drawn.
        telemetry: the spacecraft's motion.
        estimates: increasing times from which estimates are shown [s], and the estimates.
        truth: the true target, if it is known from a simulation.
        visual_model: model file with the true target's shape; default: an ellipsoid of its inertia.
        title: heading of the page.

    Raises:
        InputError: the telemetry has other joints than the spacecraft, or no samples.

    """
    if not len(telemetry):
        raise InputError("a replay needs samples")
    states, zero = spacecraft.to_states(telemetry), telemetry.time[0]
    meshcat, builder = open_meshcat(), DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, MultibodyPlant(time_step=0.0))
    if not can_be_drawn(spacecraft):
        builder = DiagramBuilder()
        plant, scene_graph = builder.AddSystem(MultibodyPlant(time_step=0.0)), None
    if truth is None:
        spacecraft.add_alone_to(plant)
    else:
        spacecraft.add_to(plant, truth, scene_graph=scene_graph, target_visual_model=visual_model)
    if scene_graph is not None:
        add_bodies(builder, plant, scene_graph, meshcat)
    scene = builder.AddSystem(SceneVisualizer(spacecraft, meshcat=meshcat, truth=truth))
    builder.Connect(plant.get_state_output_port(), scene.GetInputPort("state"))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    inputs = scene.GetMyMutableContextFromRoot(context)
    covariance, inertia = np.full(100, np.nan), SpatialInertia.NaN()
    meshcat.StartRecording(1 / FRAME_PERIOD, set_visualizations_while_recording=False)
    period = max(FRAME_PERIOD, (telemetry.time[-1] - zero) / MOST_FRAMES)
    wanted = np.arange(zero, telemetry.time[-1] + period, period)
    waiting = list(estimates)
    for k in np.unique(np.searchsorted(telemetry.time[:-1], wanted - 1e-9)):
        while waiting and waiting[0][0] <= telemetry.time[k] + 1e-9:
            found = waiting.pop(0)[1]
            covariance, inertia = found.covariance.ravel(), found.spatial_inertia()
        scene.GetInputPort("covariance").FixValue(inputs, covariance)
        scene.GetInputPort("spatial_inertia").FixValue(inputs, Value(inertia))
        plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), states[k])
        context.SetTime(telemetry.time[k] - zero)
        diagram.ForcedPublish(context)
    steps = [(at - zero, estimate_text(found, truth)) for at, found in estimates]
    return _recorded_page(meshcat, title, steps, zero)


def record_simulation(
    scenario: Scenario, progress: Callable[[float], None] = lambda time: None, *, title: str = ""
) -> tuple[str, Identification]:
    """Simulate; return a self-contained page with the recording, and the last estimate.

    Args:
        scenario: what to simulate.
        progress: called with the time [s] after every step.
        title: heading of the page.

    Raises:
        InputError: for the same reasons as `make_simulation` and `Simulation.run`.

    """
    meshcat = open_meshcat()
    simulation = make_simulation(scenario, meshcat=meshcat)
    steps: list[tuple[float, str]] = []
    period = max(0.25, scenario.simulation.duration / 60)  # of the numbers, [s]

    def record(root_context: Context) -> None:
        time = root_context.get_time()
        progress(time)
        if time + 1e-9 >= period * (len(steps) + 1):
            found = simulation.identification(root_context)
            steps.append((time, estimate_text(found, simulation.truth)))

    meshcat.StartRecording(1 / FRAME_PERIOD, set_visualizations_while_recording=False)
    context = simulation.run(record)
    last = simulation.identification(context)
    steps.append((context.get_time(), estimate_text(last, simulation.truth)))
    return _recorded_page(meshcat, title, steps, 0.0), last


def _recorded_page(
    meshcat: Meshcat, title: str, steps: Sequence[tuple[float, str]], start: float
) -> str:
    """Return a recording as a page with a title, numbers over time and a legend.

    Args:
        meshcat: what has recorded.
        title: any text; it is escaped.
        steps: times from which texts are shown, since the start of the recording [s], and texts.
        start: time at which the recording starts [s].

    """
    meshcat.StopRecording()
    meshcat.PublishRecording()
    overlay = Template(_OVERLAY.read_text(encoding="utf-8")).substitute(
        title=escape(title),
        legend="".join(f'<li style="color:{c}">{escape(t)}</li>' for c, t in LEGEND.items()),
        steps=json.dumps(steps).replace("<", "\\u003c"),
        zero=json.dumps(start),
    )
    before, end_of_body, after = meshcat.StaticHtml().rpartition("</body>")
    return f"{before}{overlay}{end_of_body}{after}".replace(
        "<title>Drake MeshCat</title>", f"<title>{escape(title or 'Replay')}</title>", 1
    )


def estimate_text(identification: Identification, truth: InertialParameters | None = None) -> str:
    """Return an estimate as short lines of text, with half-widths of 95 % intervals."""
    count = identification.sample_count
    lines = [f"from {count} sample{'s' * (count != 1)}"]
    values = identification.parameters
    if not np.isfinite(values).all():
        return f"{lines[0]}: not all ten parameters known"
    low, high = identification.intervals.T
    widths = (high - low) / 2
    parts = (("m", slice(0, 1), "kg"), ("c", slice(1, 4), "m"), ("I", slice(4, 7), "kg·m²"))
    for name, part, unit in parts:
        line = f"{name:>6} {_numbers(values[part])} {unit}"
        if np.isfinite(widths[part]).all():
            line += f" ± {widths[part].max():.2g}"
        lines.append(line)
        if truth is not None:
            lines.append(f"  true {_numbers(truth.to_vector()[part])}")
    lines += [f"failed check: {failure}" for failure in identification.failures]
    target = identification.consistent
    if target is None:
        lines.append("physically inconsistent: no rigid body is near the estimate")
    elif np.abs(target.to_vector() - values).max() > 0.01 * np.abs(values).max():
        lines.append("physically inconsistent: the nearest consistent estimate is drawn")
    return "\n".join(lines)


def _numbers(values: NDArray[np.float64]) -> str:
    """Return numbers with the decimals that give the largest of them four digits."""
    largest = float(f"{np.abs(values).max():.4g}")
    decimals = 4 if largest == 0 else max(0, 3 - int(np.floor(np.log10(largest))))
    return " ".join(f"{value + 0.0:.{min(decimals, 9)}f}" for value in np.round(values, decimals))
