"""A plan as a file: the motion, and what it is planned for."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cpid_drake.files.drafts import write_text
from cpid_drake.planning.planner import Plan, Planner
from cpid_drake.simulation.joint_motions import dump_motion


def write_plan(
    path: Path,
    planner: Planner,
    scenario: str,
    *,
    progress: Callable[..., None] = lambda what, best=np.nan: None,
) -> Plan:
    """Plan, write the motion, and return the plan; an interrupt leaves the best one so far.

    Args:
        path: YAML file of the motion.
        planner: the planner.
        scenario: the scenario's name.
        progress: see `Planner.run`.

    Raises:
        InputError: no motion keeps the limits; the file cannot be written.

    """
    try:
        return planner.run(progress)
    finally:
        if planner.best is not None:
            write_text(path, _text(planner, planner.best, scenario))


def _text(planner: Planner, plan: Plan, scenario: str) -> str:
    return (
        f"# `cpid plan motion {scenario}` for {len(planner.targets)} plausible targets.\n"
        f"# The largest σ, weighted over these targets, is {plan.score:.4g} in units of "
        "the scale. Units of this file: rad, m, s, Hz.\n\n"
        f"{dump_motion(planner.family.declare(plan.parameters))}"
    )
