"""The legend of the scene in three dimensions: its layers, and the colours of what they draw."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from pydrake.geometry import Rgba

from cpid_drake.spacecraft.appearance import GREY
from cpid_drake.systems.scene_layers import (
    CENTRE_COLOR,
    ESTIMATE_COLOR,
    SPACECRAFT_COLOR,
    TARGET_COLOR,
    TRAIL_COLOR,
    TRUTH_COLOR,
    scale_length,
)


@dataclass(frozen=True)
class Mark:
    """A colour in the scene, and its meaning.

    Attributes:
        color: CSS colour.
        meaning: what has this colour.
        parts: drawings of this colour, as in `SceneVisualizer.drawn`; the mark appears in a legend
            if one of them has been drawn.

    """

    color: str
    meaning: str
    parts: tuple[str, ...]


@dataclass(frozen=True)
class LegendLayer:
    """A layer that a page can hide: its Meshcat path, its name, and its marks."""

    path: str
    name: str
    marks: tuple[Mark, ...]


BODIES = "drake"
"""The part that stands for the shapes of the model, which Drake's own visualizer draws."""


def all_layers(size: float, *, with_truth: bool) -> list[LegendLayer]:
    """Return all layers of the scene.

    Args:
        size: size of the spacecraft, as in `Extent` [m].
        with_truth: whether the true target is known, so that it is drawn and used for the momenta.

    """
    whose, held = ("", " and target") if with_truth else (", as estimated", "")
    length = scale_length(size)
    spacecraft = f"spacecraft{held}"
    estimate = _css(ESTIMATE_COLOR)
    return [
        LegendLayer(BODIES, spacecraft, (Mark("#bbbbbb", spacecraft, (BODIES,)),)),
        LegendLayer(
            "cpid/bodies",
            "bodies without a shape",
            (Mark(_css(GREY), "bodies without a shape, as boxes of equal inertia", ("bodies",)),),
        ),
        LegendLayer(
            "cpid/estimated_centre",
            "estimated centre of mass",
            (
                Mark(
                    estimate,
                    "estimated centre of mass of the target",
                    ("estimated_centre/centre",),
                ),
                Mark(estimate, "its 3 σ", ("estimated_centre/three_sigma",)),
            ),
        ),
        LegendLayer(
            "cpid/estimated_inertia",
            "estimated inertia",
            (
                Mark(
                    estimate,
                    "estimated inertia, as the ellipsoid of equal inertia",
                    ("estimated_inertia/ellipsoid",),
                ),
            ),
        ),
        LegendLayer(
            "cpid/true_inertia",
            "true inertia",
            (Mark(_css(TRUTH_COLOR), "true inertia", ("true_inertia/ellipsoid",)),),
        ),
        LegendLayer(
            "cpid/centre_of_mass",
            "centre of mass of the whole system",
            (
                Mark(
                    _css(CENTRE_COLOR),
                    f"centre of mass of the whole system{whose}; ring: initial position",
                    ("centre_of_mass/now",),
                ),
            ),
        ),
        LegendLayer(
            "cpid/momentum",
            "momentum",
            tuple(
                Mark(
                    _css(color),
                    f"linear momentum of the {owner}{suffix}; above it: angular",
                    (f"momentum/linear_{owner}", f"momentum/angular_{owner}"),
                )
                for owner, color, suffix in (
                    ("spacecraft", SPACECRAFT_COLOR, ""),
                    ("target", TARGET_COLOR, whose),
                )
            ),
        ),
        LegendLayer(
            "cpid/trail",
            "trail",
            (Mark(_css(TRAIL_COLOR), "path of the capture point", ("trail",)),),
        ),
        LegendLayer(
            "cpid/scale",
            "length scale",
            (Mark(_css(CENTRE_COLOR), f"bar of {length:g} m in five parts", ("scale/bar",)),),
        ),
        LegendLayer(
            "cpid/frames",
            "frames W, B, C",
            (Mark("#bbbbbb", "axes of W (thin), B and C: x red, y green, z blue", ("frames/B",)),),
        ),
    ]


def legend(layers: Sequence[LegendLayer], drawn: Collection[str]) -> list[LegendLayer]:
    """Return the layers of which something has been drawn, with the marks that have been drawn.

    Args:
        layers: all layers.
        drawn: the drawings, as in `SceneVisualizer.drawn`, and `BODIES`.

    """
    shown = []
    for layer in layers:
        marks = tuple(mark for mark in layer.marks if any(p in drawn for p in mark.parts))
        if marks:
            shown.append(LegendLayer(layer.path, layer.name, marks))
    return shown


def _css(color: Rgba) -> str:
    """Return a colour as CSS writes it, without its transparency."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in (color.r(), color.g(), color.b()))
