"""Motions that rotate the base less and less: the front of precision against disturbance.

Idea: motions without reaction of the base (Nguyen-Huynh and Sharf 2013, "Adaptive reactionless
motion and parameter identification in postcapture of space debris").
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from cpid_drake.estimation.one_thread import one_thread
from cpid_drake.files.drafts import draft_folder, write_text
from cpid_drake.planning.base_motion import BASE_LIMITS
from cpid_drake.planning.planner import Plan, Planner

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
        planner.objective = free.with_limits({BASE_LIMITS[0]: float(limit)})
        start = found[-1].parameters
        plan = planner.consider(planner.improved(start, planner.options.iterations // 3))
        found += [] if plan is None else [plan]
    planner.objective = free
    kept: list[Plan] = []
    for plan in sorted(found, key=lambda one: (one.base_rotation, one.score)):
        if not kept or plan.score < kept[-1].score:
            kept.append(plan)
    return kept[::-1]


def write_front(folder: Path, planner: Planner, plans: Sequence[Plan], scenario: str) -> None:
    """Write the motions of a front for this scenario's name into a folder, with a table.

    Raises:
        InputError: a file cannot be written.

    """
    rows = ["rotation of the base [deg],worst σ [% of scale],motion"]
    with draft_folder(folder) as draft:
        for k, plan in enumerate(plans):
            name = f"motion_{k:02d}.yaml"
            write_text(draft / name, planner.describe(plan, scenario))
            rows.append(f"{np.degrees(plan.base_rotation):.6g},{100 * plan.score:.6g},{name}")
        write_text(draft / "front.csv", "\n".join(rows) + "\n")
