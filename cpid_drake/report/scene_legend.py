"""The legend of the scene in three dimensions: its layers, and the colours of what they draw."""

from dataclasses import dataclass

from pydrake.geometry import Rgba

from cpid_drake.spacecraft.appearance import GREY
from cpid_drake.systems.scene_layers import (
    CENTRE_COLOR,
    ESTIMATE_COLOR,
    SPACECRAFT_COLOR,
    TARGET_COLOR,
    TRUTH_COLOR,
)


@dataclass(frozen=True)
class LegendLayer:
    """A layer that a page can hide.

    Attributes:
        path: in Meshcat.
        marks: CSS colours, and the meaning of each.

    """

    path: str
    marks: tuple[tuple[str, str], ...]


def legend(*, with_shapes: bool, with_boxes: bool, with_truth: bool) -> list[LegendLayer]:
    """Return the layers of a scene.

    Args:
        with_shapes: whether the shapes of the model are drawn.
        with_boxes: whether some bodies have no shape.
        with_truth: whether the true target is known, so that it is drawn and used for the momenta.

    """
    whose, held = ("", " and target") if with_truth else (", as estimated", "")
    estimate, momentum = _css(ESTIMATE_COLOR), "linear momentum of the {}; above it: angular"
    layers = [
        LegendLayer(
            "cpid/estimated_centre",
            ((estimate, "estimated centre of mass of the target, and its 3 σ"),),
        ),
        LegendLayer(
            "cpid/estimated_inertia",
            ((estimate, "estimated inertia, as the ellipsoid of equal inertia"),),
        ),
        LegendLayer(
            "cpid/centre_of_mass",
            ((_css(CENTRE_COLOR), f"centre of mass of the whole system{whose}"),),
        ),
        LegendLayer(
            "cpid/momentum",
            (
                (_css(SPACECRAFT_COLOR), momentum.format("spacecraft")),
                (_css(TARGET_COLOR), momentum.format(f"target{whose}")),
            ),
        ),
        LegendLayer(
            "cpid/frames", (("#bbbbbb", "axes of W (thin), B and C: x red, y green, z blue"),)
        ),
    ]
    if with_truth:
        layers.insert(0, LegendLayer("cpid/true_inertia", ((_css(TRUTH_COLOR), "true inertia"),)))
    if with_boxes:
        boxes = (_css(GREY), "bodies without a shape, as boxes of equal inertia")
        layers.insert(0, LegendLayer("cpid/bodies", (boxes,)))
    if with_shapes:
        layers.insert(0, LegendLayer("drake", (("#bbbbbb", f"spacecraft{held}"),)))
    return layers


def _css(color: Rgba) -> str:
    """Return a colour as CSS writes it, without its transparency."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in (color.r(), color.g(), color.b()))
