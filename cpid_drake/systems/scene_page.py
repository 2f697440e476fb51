"""The words beside a scene in Meshcat, and its recording as one HTML file that plays offline."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from threading import Event

import numpy as np
from pydrake.geometry import Meshcat

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.digits import decimals, significant
from cpid_drake.files.drafts import write_text

LEGEND = {
    "orange": "estimate: 3 σ, ellipsoid of inertia",
    "silver": "true target, where one is simulated",
    "skyblue": "momentum P of spacecraft; above: L",
    "yellow": "momentum P of the target; above: L",
    "white": "centre of mass of both",
}
"""What the scene shows, by colours of CSS, as short as the lines of Meshcat's panel."""

_PARTS = (("m", slice(0, 1), "kg"), ("c", slice(1, 4), "m"), ("I", slice(4, 7), "kg·m²"))


def estimate_lines(
    parameters: Array, halves: Array, truth: InertialParameters | None = None
) -> list[str]:
    """Return mass, centre of mass and moments of inertia as short lines, with the true ones.

    Args:
        parameters: (10,) the estimate.
        halves: (10,) half-widths of its 95 % intervals.
        truth: the true target, if it is known.

    """
    if not np.isfinite(parameters).all():
        return ["not all ten parameters identifiable"]
    lines = []
    for name, part, unit in _PARTS:
        half = float(halves[part].max())
        places = min(decimals(half), 4)
        lines.append(f"{name} {_numbers(parameters[part], places)} {unit} ± {significant(half)}")
        if truth is not None:
            lines.append(f"  true {_numbers(truth.to_vector()[part], places)}")
    return lines


def _numbers(values: Array, places: int) -> str:
    return " ".join(f"{round(value, places) + 0.0:.{places}f}" for value in values)


def scene_html(
    meshcat: Meshcat,
    steps: Sequence[tuple[float, str]] = (),
    *,
    title: str = "",
    zero: float = 0.0,
    legend: Mapping[str, str] = LEGEND,
) -> str:
    """Return the scene with its published recording as a page, with legend and numbers.

    Args:
        meshcat: the scene.
        steps: increasing times of the recording from which texts are shown [s], and the texts;
            without any, the page has no legend either.
        title: heading of the page.
        zero: time that the page shows at the start of the recording [s].
        legend: what the scene shows, by colours of CSS.

    """
    legend = legend if steps else {}
    template = Path(__file__).with_name("scene_overlay.html").read_text(encoding="utf-8")
    overlay = Template(template).substitute(
        title=escape(title),
        legend="".join(f'<li style="color:{c}">{escape(t)}</li>' for c, t in legend.items()),
        steps=json.dumps(steps).replace("<", "\\u003c"),
        zero=json.dumps(zero),
    )
    before, end_of_body, after = meshcat.StaticHtml().rpartition("</body>")
    return f"{before}{overlay}{end_of_body}{after}".replace(
        "<title>Drake MeshCat</title>", f"<title>{escape(title or 'Replay')}</title>", 1
    )


def keep_scene(
    path: str | Path,
    meshcat: Meshcat,
    steps: Sequence[tuple[float, str]] = (),
    *,
    wait: bool = False,
) -> None:
    """Publish the recording, write it as a page, and print the page's name.

    Args:
        path: the page, one HTML file that plays offline; its name is its title.
        meshcat: the scene, which has been recording.
        steps: texts, see `scene_html`.
        wait: keep the live page open until Enter or Ctrl-C.

    Raises:
        InputError: the page cannot be written.

    """
    meshcat.StopRecording()
    meshcat.PublishRecording()
    write_text(path, scene_html(meshcat, steps, title=Path(path).stem))
    print(f"{path} plays the motion in a browser")
    if wait:
        wait_for_enter(meshcat.web_url())


def wait_for_enter(address: str) -> None:
    """Say that a page is open, and keep it so until Enter or Ctrl-C; without input until Ctrl-C."""
    print(f"{address} is open until Enter or Ctrl-C", end="", flush=True)
    try:
        try:
            input()
        except (EOFError, RuntimeError):  # standard input is at its end, or closed
            Event().wait()
    except KeyboardInterrupt:
        print()
