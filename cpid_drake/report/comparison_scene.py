"""The ellipsoids of several results in one scene, on their spacecraft in the model's pose."""

from itertools import cycle

import numpy as np
from pydrake.geometry import Ellipsoid, Rgba, StartMeshcat

from cpid_drake.files.errors import InputError
from cpid_drake.identification.comparison import Comparison
from cpid_drake.report.replay import estimate_text
from cpid_drake.report.scene import Scene
from cpid_drake.spacecraft.appearance import inertia_ellipsoid, three_sigma_ellipsoid
from cpid_drake.systems.scene_page import scene_html

_COLORS = {
    "orange": (1.0, 0.65, 0.0),
    "deepskyblue": (0.0, 0.75, 1.0),
    "lightgreen": (0.56, 0.93, 0.56),
    "violet": (0.93, 0.51, 0.93),
}
"""Colours of results in their order, by their names in CSS."""


_VIEW = np.array([3.3, -2.7, 1.8])
"""From the target to the camera, in W and semi-diameters of the largest ellipsoid."""


def comparison_scene(comparison: Comparison) -> str:
    """Return a page with the ellipsoids of inertia, and of three σ of the centres of mass.

    Raises:
        InputError: a result names no spacecraft, or it cannot be read; no result has all ten
            parameters.

    """
    craft = next(iter(comparison.results.values())).spacecraft
    if craft is None:
        raise InputError("a scene needs results of `cpid identify --json`, which name a spacecraft")
    bodies = {
        name: result
        for name, result in comparison.results.items()
        if not result.spatial_inertia().IsNaN()
    }
    if not bodies:
        raise InputError("a scene needs a result in which all ten parameters are known")
    spacecraft, meshcat = craft.make(), StartMeshcat()
    plant = spacecraft.plant
    context = plant.CreateDefaultContext()
    Scene(spacecraft, meshcat).draw(0.0, plant.GetPositionsAndVelocities(context))
    X_WC = spacecraft.capture_frame.CalcPoseInWorld(context)
    legend, numbers, reach, centre = dict[str, str](), list[str](), 0.0, np.zeros(3)
    for k, ((name, result), color) in enumerate(zip(bodies.items(), cycle(_COLORS), strict=False)):
        estimate = result.spatial_inertia()
        sigmas, X_CS = three_sigma_ellipsoid(estimate.get_com(), result.covariance[1:4, 1:4])
        semi_diameters, X_CE = inertia_ellipsoid(estimate)
        for shape, sizes, X_CD, alpha in (
            ("inertia", semi_diameters, X_CE, 0.3),
            ("three_sigma", np.maximum(sigmas, 1e-3 * semi_diameters.max()), X_CS, 0.6),
        ):
            path = f"/compared/{k}/{shape}"
            meshcat.SetObject(path, Ellipsoid(*sizes), Rgba(*_COLORS[color], alpha))
            meshcat.SetTransform(path, X_WC @ X_CD)
            meshcat.SetProperty(f"{path}/<object>", "material.depthTest", False)
            meshcat.SetProperty(f"{path}/<object>", "renderOrder", 10.0)
            meshcat.SetProperty(f"{path}/<object>", "material.wireframe", shape == "inertia")
        reach, centre = max(reach, float(semi_diameters.max())), X_WC @ X_CE.translation()
        legend[color] = f"{legend[color]}, {name}" if color in legend else name
        numbers.append(f"{name}\n{estimate_text(result)}")
    meshcat.SetCameraPose(centre + reach * _VIEW, centre)
    steps = [(0.0, "\n\n".join(numbers))]
    title = " and ".join(bodies)
    return scene_html(meshcat, steps, title=title, legend=legend)
