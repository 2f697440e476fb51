"""`cpid plan`: plans a joint motion, ranks motions, and exports one for a robot's controller."""

import math
import os
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.output_files.drafts import draft_folder, write_text
from cpid_drake.output_files.overwriting import check_folder, check_outputs
from cpid_drake.planning import HIGHEST_FREQUENCY
from cpid_drake.resources import find_scenario

if TYPE_CHECKING:
    from cpid_drake.identification.prior import TargetPrior
    from cpid_drake.planning.plan_problem import PlanProblem
    from cpid_drake.planning.search import Candidate
    from cpid_drake.scenario.schema import Scenario
    from cpid_drake.sensors.suite import SensorSuite

plan = typer.Typer(
    no_args_is_help=True,
    help="Plan the joint motion that determines the target best; rank motions; export one.",
)

SensorsOption = Annotated[
    str | None,
    typer.Option(
        metavar="PRESET|YAML",
        help="Sensors. Default: the scenario's, else the first of its accuracy presets.",
    ),
]
PriorOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="What is known about the target: a result of `cpid identify` (JSON), or YAML with "
        "mass, p_CTcm_C, I_TTcm_C and sigma. Default: nothing but the spacecraft's size.",
    ),
]


@plan.command()
def motion(
    scenario: options.ScenarioArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="YAML file of the planned motion.")],
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page about the plan.")
    ] = None,
    front: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Also compute the Pareto front of precision against base rotation; write its "
            "motions, a table and a figure.",
        ),
    ] = None,
    sensors: SensorsOption = None,
    prior: PriorOption = None,
    duration: Annotated[
        float | None, typer.Option(help="Duration \\[s]. Default: that of the scenario's motion.")
    ] = None,
    opportunistic: Annotated[
        float | None,
        typer.Option(
            metavar="T",
            help="Plan the transfer of the scenario to be as informative as possible, with at "
            "most T more seconds than the scenario's motion takes.",
        ),
    ] = None,
    frequency: Annotated[
        float, typer.Option(help="Highest frequency of the motion \\[Hz].")
    ] = HIGHEST_FREQUENCY,
    joint: Annotated[
        list[str] | None,
        typer.Option(help="Joint that moves; may be repeated. Default: all but wheels."),
    ] = None,
    rate_share: Annotated[
        float, typer.Option(help="Share of the model's rate limits that may be used.")
    ] = 0.95,
    acceleration: Annotated[
        float | None, typer.Option(help="Largest acceleration of the joints \\[rad/s² or m/s²].")
    ] = None,
    clearance: Annotated[
        float, typer.Option(help="Smallest distance of bodies that are not neighbours \\[m].")
    ] = 0.05,
    base_attitude: Annotated[
        float | None, typer.Option(help="Largest turn of the base \\[deg]. Default: any.")
    ] = None,
    base_rate: Annotated[
        float | None, typer.Option(help="Largest angular rate of the base \\[deg/s]. Default: any.")
    ] = None,
    base_displacement: Annotated[
        float | None,
        typer.Option(help="Largest displacement of the base's origin \\[m]. Default: any."),
    ] = None,
    wheel_momentum: Annotated[
        float | None,
        typer.Option(
            help="Largest angular momentum that each wheel stores, relative to the body that "
            "carries it [N·m·s]. The wheels move only if --joint names them. Default: any."
        ),
    ] = None,
    targets: Annotated[
        int, typer.Option(help="Number of plausible targets; the least favourable one counts.")
    ] = 8,
    candidates: Annotated[int, typer.Option(help="Motions of the global search.")] = 2000,
    starts: Annotated[int, typer.Option(help="Candidates that the gradient improves.")] = 2,
    seed: Annotated[
        int, typer.Option(help="Seed of the search; the same seed, the same plan.")
    ] = 1,
    jobs: Annotated[
        int | None, typer.Option(help="Number of processes. Default: one for each processor.")
    ] = None,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Plan the joint motion that determines the target best.

    The motion has the start and the end of the scenario's own motion. The planner does not use the
    target's mass properties in the scenario. Ctrl-C keeps the best motion so far.
    """
    path = find_scenario(scenario)
    if opportunistic is not None and duration is not None:
        raise InputError("give either --duration or --opportunistic")
    outputs = [("--out", out)]
    outputs += [] if report is None else [("--report", report)]
    check_outputs(outputs, [path, *([] if prior is None else [prior])], force=force)
    if front is not None:
        check_folder("--front", front, _front_files(), [path], force=force)
    from cpid_drake.planning.plan_options import PlanOptions
    from cpid_drake.planning.plan_problem import PlanProblem
    from cpid_drake.scenario.files import load_scenario

    loaded = load_scenario(path)
    suite = _suite(loaded, sensors)
    chosen = PlanOptions(
        duration=duration,
        opportunistic=opportunistic or 0.0,
        frequency=frequency,
        joints=tuple(joint or ()),
        rate_share=rate_share,
        acceleration=math.inf if acceleration is None else acceleration,
        clearance=clearance,
        base_attitude=None if base_attitude is None else math.radians(base_attitude),
        base_rate=None if base_rate is None else math.radians(base_rate),
        base_displacement=base_displacement,
        wheel_momentum=wheel_momentum,
        targets=targets,
        candidates=candidates,
        starts=starts,
        seed=seed,
        jobs=(os.cpu_count() or 1) if jobs is None else jobs,
    )
    with prefix_errors(scenario):
        problem = PlanProblem(loaded, suite, chosen)
        problem.prior = _prior(problem, prior)
        _plan(problem, scenario, out, report, front, quiet)


@plan.command()
def rank(
    scenario: options.ScenarioArgument,
    files: Annotated[
        list[Path], typer.Argument(metavar="MOTION...", help="YAML files of joint motions.")
    ],
    sensors: SensorsOption = None,
    prior: PriorOption = None,
) -> None:
    """Print the predicted σ of the scenario's motion and those in files, the best first."""
    path = find_scenario(scenario)
    from cpid_drake.planning.plan_options import PlanOptions
    from cpid_drake.planning.plan_problem import PlanProblem
    from cpid_drake.report.plan import print_predictions
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.scenario.joint_motions import MotionFile

    loaded = load_scenario(path)
    with prefix_errors(scenario):
        problem = PlanProblem(loaded, _suite(loaded, sensors), PlanOptions())
        problem.prior = _prior(problem, prior)
        found = {"scenario's motion": problem.own_motion}
        for file in files:
            found[file.name] = MotionFile(str(file)).make(
                problem.spacecraft, loaded.spacecraft.configuration
            )
        target = problem.plausible(1, problem.options.seed)[0].parameters
        predictions = {name: problem.setting.predict(each, target) for name, each in found.items()}
    ordered = dict(sorted(predictions.items(), key=lambda item: item[1].worst))
    title = f"Predicted σ, a target of {target[0]:.3g} kg; the best motion first"
    print_predictions(ordered, title, Console(markup=False, highlight=False))


def _prior(problem: "PlanProblem", file: Path | None) -> "TargetPrior | None":
    if file is None:
        return None
    from cpid_drake.identification.prior import load_prior

    return load_prior(file, problem.spacecraft, problem.scenario.spacecraft.capture_frame)


def _plan(
    problem: "PlanProblem",
    scenario: str,
    out: Path,
    report: Path | None,
    front: Path | None,
    quiet: bool,
) -> None:
    """Plan, write the motion, and print what it is expected to do."""
    from cpid_drake.planning.planner import Planner

    planner, start = Planner(problem), time.perf_counter()
    log = options.log_console(quiet)
    with log.status("planning") as status:

        def progress(what: str, best: float) -> None:
            status.update(f"{what}: worst σ {100 * best:.3g} % of scale")

        try:
            best = planner.run(progress)
        except KeyboardInterrupt:
            if planner.best is not None:
                _write(problem, planner.best, scenario, out, is_finished=False)
            raise
    _write(problem, best, scenario, out)
    if front is not None:
        better = _plan_front(problem, best, scenario, front, quiet)
        if better.score < best.score:
            best = better
            _write(problem, best, scenario, out)
    log.print(f"{out}: {time.perf_counter() - start:.0f} s")
    exceeded = planner.exceeded(best)
    options.print_warnings(exceeded)
    if quiet and report is None:
        return
    from cpid_drake.report.plan import print_predictions

    target, active = problem.targets[0], planner.active(best)
    predictions = {
        "scenario's motion": problem.setting.predict(problem.own_motion, target),
        "plan": problem.setting.predict(problem.motion(best), target),
    }
    own, planned = predictions.values()
    if own.worst < planned.worst and (needs := planner.own_needs()) > 1:
        problem.notes.append(
            "the scenario's motion is more precise, but with some of the plausible targets it "
            f"needs {needs:.2g} times what the limits allow"
        )
    for note in problem.notes:
        log.print(f"note: {note}")
    if report is not None:
        from cpid_drake.report.pages.plan import PlannedMotion, plan_report

        page = PlannedMotion(
            problem.setting,
            problem.motion(best),
            target,
            predictions,
            active,
            exceeded,
            problem.notes,
            scenario,
            shlex.join(["cpid", *sys.argv[1:]]),
            problem.scenario.target.visual_model,
        )
        plan_report(page).write(report)
    if quiet:
        return
    title = f"Predicted σ, a target of {target[0]:.3g} kg"
    print_predictions(predictions, title, Console(markup=False, highlight=False))
    print(f"active limits: {'; '.join(active) or 'none'}")
    print(f"cpid simulate SCENARIO --out DIR, with joint_motion: !MotionFile {{file: {out}}}")


def _front_files() -> list[str]:
    """Return the names of the files of a front."""
    from cpid_drake.planning.pareto import POINTS

    motions = [f"motion_{k:02d}.yaml" for k in range(2 * POINTS + 1)]
    return ["front.csv", "front.png", *motions]


def _plan_front(
    problem: "PlanProblem", best: "Candidate", scenario: str, folder: Path, quiet: bool
) -> "Candidate":
    """Plan motions that turn the base less and less; write them, a table and a figure.

    The most precise of them is returned; it may be better than the plan.
    """
    import numpy as np

    from cpid_drake.planning.pareto import front
    from cpid_drake.report.plan import front_picture

    log = options.log_console(quiet)
    with log.status("planning") as status, draft_folder(folder) as draft:
        points: list[tuple[float, float, str]] = []
        found = front(problem, best, progress=lambda what, _: status.update(what))
        for point in found:
            name = f"motion_{len(points):02d}.yaml"
            _write(problem, point.candidate, scenario, draft / name)
            points.append((math.degrees(point.angle), 100 * point.candidate.score, name))
        rows = [f"{angle:.6g},{score:.6g},{name}" for angle, score, name in points]
        head = "turn of the base [deg],worst σ [% of scale],motion"
        write_text(draft / "front.csv", "\n".join([head, *rows]) + "\n")
        values = np.array([each[:2] for each in points])
        front_picture(values).save(draft, "png")
    log.print(f"{len(points)} motions in {folder}")
    return min((point.candidate for point in found), key=lambda one: one.score)


def _write(
    problem: "PlanProblem", best: "Candidate", scenario: str, out: Path, *, is_finished: bool = True
) -> None:
    from cpid_drake.scenario.joint_motions import dump_motion

    interrupted = "# Interrupted: the best motion within all limits until then.\n"
    header = ("" if is_finished else interrupted) + (
        f"# `cpid plan motion {scenario}` for {len(problem.targets)} plausible targets.\n"
        f"# The largest σ, weighted over these targets, is {best.score:.4g} in units of "
        "the scale. Units of this file: rad, m, s, Hz.\n\n"
    )
    write_text(out, header + dump_motion(problem.family.declare(best.parameters)))


def _suite(scenario: "Scenario", sensors: str | None) -> "SensorSuite":
    from cpid_drake.sensors.presets import load_sensors

    own = scenario.make_suite() if sensors is None else None
    return own or load_sensors(sensors or scenario.accuracy.presets[0])


@plan.command()
def export(
    file: Annotated[Path, typer.Argument(metavar="MOTION", help="YAML file of a joint motion.")],
    scenario: Annotated[
        str, typer.Option(metavar="SCENARIO", help="Scenario with the spacecraft of the motion.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="CSV file to write.")],
    rate: Annotated[float, typer.Option(help="Rows per second [Hz].")] = 100.0,
    force: options.ForceOption = False,
) -> None:
    """Write a joint motion as CSV: time, positions, rates and accelerations of all joints."""
    path = find_scenario(scenario)
    check_outputs([("--out", out)], [path, file], force=force)
    from cpid_drake.planning.export import motion_table
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.scenario.joint_motions import MotionFile

    loaded = load_scenario(path)
    spacecraft = loaded.spacecraft.make()
    motion = MotionFile(str(file)).make(spacecraft, loaded.spacecraft.configuration)
    write_text(out, motion_table(motion, spacecraft.joint_names, rate))
