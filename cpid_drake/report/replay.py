"""A replay of telemetry with the estimates over time: one HTML file that plays offline."""

import json
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.identification.result import Identification
from cpid_drake.report.scene_legend import LegendLayer, legend
from cpid_drake.scenario.simulation import Simulation
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.scene_visualizer import (
    FRAME_PERIOD,
    SceneVisualizer,
    can_be_drawn,
    extent_of,
    open_meshcat,
    prepare_meshcat,
    shapeless_bodies,
)

_OVERLAY = Path(__file__).with_name("replay_overlay.html")

MOST_ESTIMATES = 60
"""Largest number of estimates in the replay of a simulation."""

MOST_FRAMES = 640
"""Largest number of frames of a replay; in longer logs they are over `FRAME_PERIOD` apart."""


def replay_html(
    spacecraft: Spacecraft,
    telemetry: Telemetry,
    estimates: Sequence[tuple[float, Identification]],
    *,
    truth: InertialParameters | None = None,
    visual_model: str | Path | None = None,
    title: str = "",
) -> str:
    """Return a self-contained page that replays a motion with the estimates over time.

    Args:
        spacecraft: the known spacecraft. Bodies whose shapes cannot be drawn become boxes.
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
    states = spacecraft.to_states(telemetry)
    frames = _frames(telemetry.time)
    zero = telemetry.time[0]

    meshcat = open_meshcat()
    targets = (found.consistent for _, found in reversed(estimates))
    extent = extent_of(spacecraft, telemetry, truth or next(filter(None, targets), None))
    prepare_meshcat(meshcat, extent)
    builder, plant, shapeless = _start_diagram(meshcat, spacecraft, truth, visual_model)
    scene = builder.AddSystem(
        SceneVisualizer(
            spacecraft, meshcat=meshcat, extent=extent, truth=truth, shapeless=shapeless
        )
    )
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    inputs = scene.GetMyMutableContextFromRoot(context)
    feed = {name: scene.GetInputPort(name) for name in ("covariance", "spatial_inertia")}
    feed["covariance"].FixValue(inputs, np.full(100, np.nan))
    feed["spatial_inertia"].FixValue(inputs, Value(SpatialInertia.NaN()))

    meshcat.StartRecording(1 / FRAME_PERIOD, set_visualizations_while_recording=False)
    shown = -1
    for k, newest in zip(frames, newest_estimates(estimates, telemetry.time[frames])):
        time = telemetry.time[k]
        if newest != shown:
            shown, found = newest, estimates[newest][1]
            feed["covariance"].FixValue(inputs, found.covariance.ravel())
            feed["spatial_inertia"].FixValue(inputs, Value(found.spatial_inertia()))
        scene.GetInputPort("state").FixValue(inputs, states[k])
        if plant is not None:
            plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), states[k])
        context.SetTime(time - zero)
        diagram.ForcedPublish(context)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    steps = [(at - zero, estimate_text(found, truth)) for at, found in estimates]
    layers = legend(
        with_shapes=plant is not None, with_boxes=scene.has_boxes, with_truth=truth is not None
    )
    return _page(meshcat.StaticHtml(), title, steps, zero, layers)


def _page(
    static_html: str,
    title: str,
    steps: Sequence[tuple[float, str]],
    start: float,
    layers: Sequence[LegendLayer],
) -> str:
    """Return Meshcat's page with a title, the estimates and a legend that hides layers.

    Args:
        static_html: the page that Meshcat wrote.
        title: any text; it is escaped.
        steps: times from which texts are shown, since the start of the replay [s], and the texts.
        start: time at which the replay starts [s].
        layers: the layers of the scene.

    """
    rows = []
    for layer in layers:
        names = (f'<i style="color:{c}">●</i> {escape(text)}' for c, text in layer.marks)
        rows.append(
            f'<label><input type="checkbox" value="{layer.path}"> {" ".join(names)}</label>'
        )
    overlay = Template(_OVERLAY.read_text(encoding="utf-8")).substitute(
        title=escape(title),
        layers="\n".join(rows),
        steps=json.dumps(steps).replace("<", "\\u003c"),
        zero=json.dumps(start),
    )
    before, end_of_body, after = static_html.rpartition("</body>")
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


def newest_estimates(
    estimates: Sequence[tuple[float, Identification]], times: NDArray[np.float64]
) -> NDArray[np.intp]:
    """Return the index of the estimate to show at each time; −1 before the first one."""
    starts = np.array([start for start, _ in estimates])
    return np.searchsorted(starts, times + 1e-9, side="right") - 1


def _frames(time: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return indices of the samples to draw: about `FRAME_PERIOD` apart, and the last one."""
    duration = time[-1] - time[0]
    period = max(FRAME_PERIOD, duration / MOST_FRAMES)
    wanted = np.arange(time[0], time[-1], period)
    return np.unique(np.append(np.searchsorted(time, wanted - 1e-9), len(time) - 1))


def replay_simulation(
    simulation: Simulation,
    progress: Callable[[float], None] = lambda time: None,
    *,
    title: str = "",
) -> tuple[str, Identification]:
    """Simulate; return the page that replays the simulation, and the last estimate.

    Args:
        simulation: the simulation to run.
        progress: called with the time [s] after every step.
        title: heading of the page.

    """
    estimates: list[tuple[float, Identification]] = []
    period = max(0.25, simulation.scenario.simulation.duration / MOST_ESTIMATES)

    def record(root_context: Context) -> None:
        time = root_context.get_time()
        progress(time)
        if time + 1e-9 >= period * (len(estimates) + 1):
            estimates.append((time, simulation.identification(root_context)))

    context = simulation.run(record)
    last = simulation.identification(context)
    page = replay_html(
        simulation.spacecraft,
        simulation.telemetry(context),
        [*estimates, (context.get_time(), last)],
        truth=simulation.truth,
        visual_model=simulation.scenario.target.visual_model,
        title=title,
    )
    return page, last


def _start_diagram(
    meshcat: Meshcat,
    spacecraft: Spacecraft,
    truth: InertialParameters | None,
    visual_model: str | Path | None,
) -> tuple[DiagramBuilder, MultibodyPlant | None, list[BodyIndex]]:
    """Return a builder with a plant for drawing, and the bodies that have no shape in it.

    If the model's shapes cannot be read, there is no plant, and all bodies are without a shape.
    """
    builder = DiagramBuilder()
    if not can_be_drawn(spacecraft):
        return builder, None, shapeless_bodies(spacecraft)
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, MultibodyPlant(time_step=0.0))
    if truth is not None:
        spacecraft.add_to(plant, truth, scene_graph=scene_graph, target_visual_model=visual_model)
    else:
        spacecraft.add_alone_to(plant)
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
    return builder, plant, shapeless_bodies(spacecraft, plant, scene_graph)
