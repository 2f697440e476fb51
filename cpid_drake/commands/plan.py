"""`cpid plan`: plans a joint motion, ranks motions, and exports one for a robot's controller."""

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Group, Parameter
from cyclopts.validators import Number as Within

import cpid_drake as cpid
from cpid_drake import planning, report, simulation
from cpid_drake.commands import options
from cpid_drake.commands.groups import group
from cpid_drake.files.digits import significant
from cpid_drake.files.drafts import draft_folder, draft_of, write_text
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.overwriting import check_folder, check_outputs
from cpid_drake.files.resources import find_scenario

plan = group("plan")

_KNOWN = Parameter(group=Group.create_ordered("What is known"))


@Parameter("*")
@dataclass(frozen=True)
class Choices(planning.PlanOptions):
    """The options of a plan and of a comparison."""

    sensors: Annotated[options.Sensors | None, _KNOWN] = None
    """Sensors. Default: the scenario's, else flight."""
    prior: Annotated[options.File | None, _KNOWN] = None
    """What is known about the target: a result of `cpid identify` (JSON), or YAML with mass,
    p_CTcm_C, I_TTcm_C and sigma. Default: nothing but the spacecraft's size."""


@plan.command
def motion(
    scenario: options.Scenario,
    /,
    *,
    out: options.File,
    chosen: Choices = Choices(),
    picture: options.File | None = None,
    front: options.Folder | None = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Plan an exciting joint motion: one that determines the target best.

    The motion has the start and the end of the scenario's own motion. The planner does not use the
    target's mass properties in the scenario. Ctrl-C keeps the best motion so far.

    Args:
        out: YAML file of the planned motion.
        picture: PNG or SVG file with σ, joints and base of the plan.
        front: Also compute the Pareto front of precision against base rotation; write its motions
            and a table.

    """
    path, start = find_scenario(scenario), time.perf_counter()
    inputs = [path, chosen.prior]
    check_outputs([("--out", out), ("--picture", picture)], inputs, force=force)
    check_folder("--front", front, inputs, force=force)
    if picture is not None and picture.suffix not in (".png", ".svg"):
        raise InputError(f"--picture {picture}: give the name of a .png or .svg file")
    log = options.log_console(quiet)
    with prefix_errors(scenario), log.status("planning") as status:

        def progress(what: str, best: float = math.nan) -> None:
            known = "" if math.isnan(best) else f": worst σ {significant(100 * best, 3)} % of scale"
            status.update(f"{what}{known}")

        planner = planning.load_planner(path, chosen.sensors, chosen, chosen.prior)
        try:
            best = planner.run(progress)
        except KeyboardInterrupt:
            if planner.best is not None:
                write_text(out, planner.describe(planner.best, scenario))
            raise
        if front is not None:
            best, *_ = plans = planning.front(planner, best, progress)
            rows = ["rotation of the base [deg],worst σ [% of scale],motion"]
            with draft_folder(front) as draft:
                for k, each in enumerate(plans):
                    name = f"motion_{k:02d}.yaml"
                    write_text(draft / name, planner.describe(each, scenario))
                    rows.append(
                        f"{math.degrees(each.base_rotation):.6g},{100 * each.score:.6g},{name}"
                    )
                write_text(draft / "front.csv", "\n".join(rows) + "\n")
            log.print(f"{len(plans)} motions in {front}")
        write_text(out, planner.describe(best, scenario))
        log.print(f"{out}: {time.perf_counter() - start:.0f} s")
        target = planner.targets[0]
        made = {"scenario's motion": planner.own_motion, "plan": best.motion}
        usage, _ = planner.usage(planner.own_motion)
        found = {
            name: replace(planner.setting.predict(each, target), usage=max(used.values()))
            for (name, each), used in zip(made.items(), (usage, best.usage), strict=True)
        }
    limit = max(usage, key=lambda name: usage[name])
    if usage[limit] > 1:
        planner.notes.append(
            "with some of the plausible targets the scenario's motion needs "
            f"{significant(usage[limit])} times the limit: {limit}"
        )
    for note in planner.notes:
        log.print(f"note: {note}")
    if picture is not None:
        from cpid_drake.files.pictures import save_pictures  # loads Matplotlib

        with draft_of(picture) as draft:
            drawn = report.plan_pictures(planner.setting, made, found, target)
            save_pictures(draft, picture.suffix[1:], drawn, 2)
    if quiet:
        return
    title = f"Predicted σ, a target of {target[0]:.3g} kg"
    report.print_table(report.motion_table(found, title))
    print(f"active limits: {'; '.join(best.active) or 'none'}")
    print(f"cpid simulate SCENARIO --out DIR, with joint_motion: !MotionFile {{file: {out}}}")


@plan.command
def rank(
    scenario: options.Scenario,
    motions: list[Path] | None = None,
    /,
    *,
    chosen: Choices = Choices(),
    trials: Annotated[options.Count, Parameter(validator=Within(gte=0))] = 0,
    quiet: options.Quiet = False,
) -> None:
    """Compare motions in files with the scenario's, random and broadband ones.

    Prints the predicted σ and, with trials, the errors of the fit. The random and the broadband
    motions (a chirp of all joints, a smoothed random binary sequence) keep the limits.

    Args:
        motions: YAML files of motions.
        trials: Noisy logs that are simulated and identified for each motion.

    """
    path, log = find_scenario(scenario), options.log_console(quiet)
    with prefix_errors(scenario), log.status("ranking") as status:
        planner = planning.load_planner(path, chosen.sensors, chosen, chosen.prior)
        given = {file.name: planner.load_motion(file) for file in motions or []}
        target, craft, found = planner.targets[0], planner.spacecraft, {}
        body = cpid.InertialParameters.from_vector(target)
        suite = planner.suite.exact()
        case = simulation.make_case(planner.scenario, craft, body, suite, chosen.seed)
        for name, each in {**dict(planning.reference_motions(planner)), **given}.items():
            errors = []
            moving = replace(case, motion=each, duration=each.duration)
            for error in simulation.fit_errors(moving, craft, trials):
                errors.append(error)
                status.update(f"{name}: {len(errors)} of {trials} trials")
            found[name] = replace(
                planner.setting.predict(each, target),
                usage=max(planner.usage(each)[0].values()),
                errors=np.reshape(errors, (-1, 10)),
            )
    for note in planner.notes:
        log.print(f"note: {note}")
    ordered = dict(sorted(found.items(), key=lambda item: item[1].worst))
    title = f"Motions for a target of {target[0]:.3g} kg, the best first"
    report.print_table(report.motion_table(ordered, title))
    if trials:
        correlation = report.rank_correlation(found)
        print(f"rank correlation of predicted and realised errors: {correlation:.2f}")


@plan.command
def export(
    motion: Path,
    /,
    *,
    scenario: Annotated[options.FileName, Parameter(metavar="SCENARIO")],
    out: options.File,
    rate: Annotated[options.Rate, Parameter(validator=Within(gte=0.1, lte=1e4))] = 100.0,
    force: options.Force = False,
) -> None:
    """Write a joint motion as CSV: time, positions, rates and accelerations of all joints.

    Args:
        motion: YAML file of a joint motion.
        scenario: Scenario with the spacecraft of the motion.
        out: CSV file to write.
        rate: Rows per second.

    """
    path = find_scenario(scenario)
    check_outputs([("--out", out)], [path, motion], force=force)
    planner = planning.load_planner(path, None, planning.PlanOptions())
    made = planner.load_motion(motion)
    times = np.linspace(0.0, made.duration, math.ceil(made.duration * rate - 1e-9) + 1)
    names = [f"{q}:{joint}" for q in ("q", "qd", "qdd") for joint in planner.spacecraft.joint_names]
    table = np.column_stack([times, made.evaluate(times).reshape(len(times), -1)])
    with draft_of(out) as draft:
        np.savetxt(draft, table, "%.12g", ",", header=",".join(["time", *names]), comments="")
