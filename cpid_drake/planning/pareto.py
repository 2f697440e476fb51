"""A plan as files; motions that rotate the base less and less, the front of precision against it.

Idea: motions without reaction of the base (Nguyen-Huynh and Sharf 2013, "Adaptive reactionless
motion and parameter identification in postcapture of space debris").
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cpid_drake.estimation.one_thread import one_thread
from cpid_drake.files.drafts import draft_folder, write_text
from cpid_drake.planning.base_motion import BASE_LIMITS
from cpid_drake.planning.planner import Plan, Planner
from cpid_drake.simulation.joint_motions import dump_motion

POINTS = 10
"""Number of limits of the base's rotation, in equal ratios: enough to draw the front."""


@one_thread
def front(
    planner: Planner, best: Plan, progress: Callable[[str], None] = lambda what: None
) -> list[Plan]:
    """Return plans none of which is better than another in both rotation and criterion.

    Limits of the rotation are lowered step by step to a twentieth of that of `best`, and each
    motion is improved from the one before. The largest rotation is the first. Limits for which no
    motion is found are left out.
    """
    found, free = [best], planner.objective
    for limit in best.base_rotation * np.geomspace(1.0, 0.05, POINTS + 1)[1:]:
        progress(f"rotation of the base below {np.degrees(limit):.3g} deg")
        limits = {**free.limits, BASE_LIMITS[0]: float(limit)}
        planner.objective = replace(free, limits=limits)
        start = found[-1].parameters
        plan = planner.consider(planner.improved(start, planner.options.iterations // 3))
        found += [] if plan is None else [plan]
    planner.objective = free
    kept: list[Plan] = []
    for plan in sorted(found, key=lambda one: (one.base_rotation, one.score)):
        if not kept or plan.score < kept[-1].score:
            kept.append(plan)
    return kept[::-1]


def write_plan(
    path: Path,
    planner: Planner,
    scenario: str,
    *,
    folder: Path | None = None,
    progress: Callable[..., None] = lambda what, best=np.nan: None,
) -> tuple[Plan, int]:
    """Plan, and write the motion; an interrupt leaves the best one so far in the file.

    Args:
        path: YAML file of the motion.
        planner: the planner.
        scenario: the scenario's name.
        folder: where the motions of the front are written, whose most precise one is the plan;
            default: no front.
        progress: see `Planner.run`.

    Returns:
        The plan, and the number of motions of the front.

    Raises:
        InputError: no motion keeps the limits; a file cannot be written.

    """
    try:
        best = planner.run(progress)
    except KeyboardInterrupt:
        if planner.best is not None:
            write_text(path, _text(planner, planner.best, scenario))
        raise
    plans = []
    if folder is not None:
        best, *_ = plans = front(planner, best, progress)
        _write_front(folder, planner, plans, scenario)
    write_text(path, _text(planner, best, scenario))
    return best, len(plans)


def _write_front(folder: Path, planner: Planner, plans: Sequence[Plan], scenario: str) -> None:
    rows = ["rotation of the base [deg],worst σ [% of scale],motion"]
    with draft_folder(folder) as draft:
        for k, plan in enumerate(plans):
            name = f"motion_{k:02d}.yaml"
            write_text(draft / name, _text(planner, plan, scenario))
            rows.append(f"{np.degrees(plan.base_rotation):.6g},{100 * plan.score:.6g},{name}")
        write_text(draft / "front.csv", "\n".join(rows) + "\n")


def _text(planner: Planner, plan: Plan, scenario: str) -> str:
    return (
        f"# `cpid plan motion {scenario}` for {len(planner.targets)} plausible targets.\n"
        f"# The largest σ, weighted over these targets, is {plan.score:.4g} in units of "
        "the scale. Units of this file: rad, m, s, Hz.\n\n"
        f"{dump_motion(planner.family.declare(plan.parameters))}"
    )
