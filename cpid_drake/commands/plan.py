"""`cpid plan`: plans a joint motion, ranks motions, and exports one for a robot's controller."""

import math
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.identification.prior import load_prior
from cpid_drake.output_files.drafts import draft_folder, draft_of, write_text
from cpid_drake.output_files.overwriting import check_folder, check_outputs
from cpid_drake.planning.comparison import Compared, reference_motions, trial_errors
from cpid_drake.planning.export import motion_table
from cpid_drake.planning.pareto import POINTS, front
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.planner import Plan, Planner
from cpid_drake.report.plan import (
    comparison_table,
    front_picture,
    plan_pictures,
    prediction_table,
    rank_correlation,
)
from cpid_drake.report.terminal import print_table
from cpid_drake.resources import find_scenario
from cpid_drake.scenario.files import load_scenario
from cpid_drake.scenario.joint_motions import MotionFile, dump_motion
from cpid_drake.sensors.presets import load_sensors

plan = typer.Typer(
    no_args_is_help=True,
    help="Plan the joint motion that determines the target best; rank motions; export one.",
)


def _option(group: str, text: str, **settings: Any) -> Any:
    """Return an option of a group in the help."""
    return typer.Option(help=text, rich_help_panel=group, **settings)


_KNOWN, _MOTION, _LIMITS, _SEARCH = "What is known", "The motion", "Limits", "The search"
_ANY: dict[str, Any] = {"show_default": False}  # of a limit whose default is infinite


@dataclass(frozen=True)
class CommonOptions:
    """The options of a plan and of a comparison."""

    sensors: Annotated[
        str | None,
        _option(
            _KNOWN,
            "Sensors. Default: the scenario's, else the first of its accuracy presets.",
            metavar="PRESET|YAML",
        ),
    ] = None
    prior: Annotated[
        Path | None,
        _option(
            _KNOWN,
            "What is known about the target: a result of `cpid identify` (JSON), or YAML with "
            "mass, p_CTcm_C, I_TTcm_C and sigma. Default: nothing but the spacecraft's size.",
            metavar="FILE",
        ),
    ] = None
    frequency: Annotated[float, _option(_MOTION, "Highest frequency of the motion \\[Hz].")] = (
        PlanOptions.frequency
    )
    joint: Annotated[
        list[str] | None,
        _option(_MOTION, "Joint that moves; may be repeated. Default: all but wheels."),
    ] = None
    rate_share: Annotated[
        float, _option(_LIMITS, "Share of the model's rate limits that may be used.")
    ] = PlanOptions.rate_share
    acceleration: Annotated[
        float,
        _option(
            _LIMITS, "Largest acceleration of the joints \\[rad/s² or m/s²]. Default: any.", **_ANY
        ),
    ] = PlanOptions.acceleration
    clearance: Annotated[
        float, _option(_LIMITS, "Smallest distance of bodies that are not neighbours \\[m].")
    ] = PlanOptions.clearance
    targets: Annotated[
        int, _option(_SEARCH, "Number of plausible targets; the least favourable one counts.")
    ] = PlanOptions.targets
    seed: Annotated[int, _option(_SEARCH, "Seed; the same seed, the same motions.")] = (
        PlanOptions.seed
    )

    def planner(self, path: Path | str, **more: Any) -> Planner:
        """Return the planner of a scenario's file with these and further options."""
        scenario = load_scenario(path)
        own = scenario.make_suite() if self.sensors is None else None
        suite = own or load_sensors(self.sensors or scenario.accuracy.presets[0])
        names = {field.name for field in fields(self)} & {each.name for each in fields(PlanOptions)}
        given = {name: getattr(self, name) for name in names}
        chosen = PlanOptions(joints=tuple(self.joint or ()), **given, **more)
        planner = Planner(scenario, suite, chosen)
        if self.prior is not None:
            frame = scenario.spacecraft.capture_frame
            planner.prior = load_prior(self.prior, planner.spacecraft, frame)
        return planner


@plan.command()
@options.with_options
def motion(
    scenario: options.ScenarioArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="YAML file of the planned motion.")],
    common: CommonOptions,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="PNG or SVG file with σ, joints and base of the plan."),
    ] = None,
    front_folder: Annotated[
        Path | None,
        typer.Option(
            "--front",
            metavar="FOLDER",
            help="Also compute the Pareto front of precision against base rotation; write its "
            "motions, a table and a figure.",
        ),
    ] = None,
    duration: Annotated[
        float | None, _option(_MOTION, "Duration \\[s]. Default: that of the scenario's motion.")
    ] = None,
    opportunistic: Annotated[
        float,
        _option(
            _MOTION,
            "Plan the transfer of the scenario to be as informative as possible, with at most T "
            "more seconds than the scenario's motion takes.",
            metavar="T",
        ),
    ] = PlanOptions.opportunistic,
    base_attitude: Annotated[
        float, _option(_LIMITS, "Largest turn of the base \\[deg]. Default: any.", **_ANY)
    ] = PlanOptions.base_attitude,
    base_rate: Annotated[
        float, _option(_LIMITS, "Largest angular rate of the base \\[deg/s]. Default: any.", **_ANY)
    ] = PlanOptions.base_rate,
    base_displacement: Annotated[
        float,
        _option(_LIMITS, "Largest displacement of the base's origin \\[m]. Default: any.", **_ANY),
    ] = PlanOptions.base_displacement,
    wheel_momentum: Annotated[
        float,
        _option(
            _LIMITS,
            "Largest angular momentum that each wheel stores, relative to the body that carries "
            "it [N·m·s]. The wheels move only if --joint names them. Default: any.",
            **_ANY,
        ),
    ] = PlanOptions.wheel_momentum,
    candidates: Annotated[
        int, _option(_SEARCH, "Motions of the global search.")
    ] = PlanOptions.candidates,
    starts: Annotated[
        int, _option(_SEARCH, "Candidates that the gradient method improves.")
    ] = PlanOptions.starts,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Plan the joint motion that determines the target best.

    The motion has the start and the end of the scenario's own motion. The planner does not use the
    target's mass properties in the scenario. Ctrl-C keeps the best motion so far.
    """
    path, start = find_scenario(scenario), time.perf_counter()
    inputs = [path, *([] if common.prior is None else [common.prior])]
    outputs = [("--out", out), *([] if picture is None else [("--picture", picture)])]
    check_outputs(outputs, inputs, force=force)
    if picture is not None and picture.suffix not in (".png", ".svg"):
        raise InputError(f"--picture {picture}: give the name of a .png or .svg file")
    if front_folder is not None:
        files = ["front.csv", "front.png", *(f"motion_{k:02d}.yaml" for k in range(POINTS + 1))]
        check_folder("--front", front_folder, files, inputs, force=force)
    log = options.log_console(quiet)
    with prefix_errors(scenario):
        planner = common.planner(
            path,
            duration=duration,
            opportunistic=opportunistic,
            base_attitude=math.radians(base_attitude),
            base_rate=math.radians(base_rate),
            base_displacement=base_displacement,
            wheel_momentum=wheel_momentum,
            candidates=candidates,
            starts=starts,
        )
        try:
            with log.status("planning") as status:
                best = planner.run(lambda what, best: status.update(_progress(what, best)))
        except KeyboardInterrupt:
            if planner.best is not None:
                _write(planner, planner.best, scenario, out)
            raise
        if front_folder is not None:
            best = _write_front(planner, best, scenario, front_folder, quiet)
        _write(planner, best, scenario, out)
        log.print(f"{out}: {time.perf_counter() - start:.0f} s")
        target = planner.targets[0].parameters
        made = {"scenario's motion": planner.own_motion, "plan": best.motion}
        found = {name: planner.setting.predict(each, target) for name, each in made.items()}
        usage, _ = planner.usage(planner.own_motion)
    limit = max(usage, key=lambda name: usage[name])
    if usage[limit] > 1:
        planner.notes.append(
            "with some of the plausible targets the scenario's motion needs "
            f"{usage[limit]:.2g} times the limit: {limit}"
        )
    for note in planner.notes:
        log.print(f"note: {note}")
    if picture is not None:
        with draft_of(picture) as draft:
            drawn = plan_pictures(draft.stem, planner.setting, made, found, target)
            drawn.save(draft.parent, draft.suffix[1:])
    if quiet:
        return
    title = f"Predicted σ, a target of {target[0]:.3g} kg"
    print_table(Console(markup=False, highlight=False), prediction_table(found, title))
    print(f"active limits: {'; '.join(best.active) or 'none'}")
    print(f"cpid simulate SCENARIO --out DIR, with joint_motion: !MotionFile {{file: {out}}}")


@plan.command()
@options.with_options
def rank(
    scenario: options.ScenarioArgument,
    common: CommonOptions,
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="[MOTION]...", help="YAML files of motions.")
    ] = None,
    trials: Annotated[
        int,
        typer.Option(help="Noisy logs that are simulated and identified for each motion.", min=0),
    ] = 0,
    quiet: options.QuietOption = False,
) -> None:
    """Compare motions in files with the scenario's, random and broadband ones.

    Prints the predicted σ and, with trials, the errors of the fit. The random and the broadband
    motions (a chirp of all joints, a smoothed random binary sequence) keep the limits.
    """
    path, log = find_scenario(scenario), options.log_console(quiet)
    with prefix_errors(scenario), log.status("ranking") as status:
        planner = common.planner(path)
        craft, default = planner.spacecraft, planner.scenario.spacecraft.configuration
        given = {file.name: MotionFile(str(file)).make(craft, default) for file in files or []}
        target, setting, found = planner.targets[0].parameters, planner.setting, {}
        for name, each in {**dict(reference_motions(planner)), **given}.items():
            prediction, errors = setting.predict(each, target), []
            for error in trial_errors(setting, each, target, trials, common.seed):
                errors.append(error)
                status.update(f"{name}: {len(errors)} of {trials} trials")
            usage, _ = planner.usage(each)
            found[name] = Compared(prediction, max(usage.values()), np.reshape(errors, (-1, 10)))
    for note in planner.notes:
        log.print(f"note: {note}")
    ordered = dict(sorted(found.items(), key=lambda item: item[1].prediction.worst))
    title = f"Motions for a target of {target[0]:.3g} kg, the best first"
    print_table(Console(markup=False, highlight=False), comparison_table(ordered, title))
    if trials:
        print(f"rank correlation of predicted and realised errors: {rank_correlation(found):.2f}")


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
    loaded = load_scenario(path)
    spacecraft = loaded.spacecraft.make()
    made = MotionFile(str(file)).make(spacecraft, loaded.spacecraft.configuration)
    write_text(out, motion_table(made, spacecraft.joint_names, rate))


def _progress(what: str, best: float) -> str:
    return what if math.isnan(best) else f"{what}: worst σ {100 * best:.3g} % of scale"


def _write_front(planner: Planner, best: Plan, scenario: str, folder: Path, quiet: bool) -> Plan:
    """Plan motions that turn the base less and less; write them, a table and a figure.

    The most precise of them is returned; it may be better than the plan.
    """
    log = options.log_console(quiet)
    with log.status("planning") as status, draft_folder(folder) as draft:
        found = front(planner, best, progress=status.update)
        rows, values = ["turn of the base [deg],worst σ [% of scale],motion"], []
        for k, each in enumerate(found):
            name = f"motion_{k:02d}.yaml"
            _write(planner, each, scenario, draft / name)
            values.append((math.degrees(each.turn), 100 * each.score))
            rows.append(f"{values[-1][0]:.6g},{values[-1][1]:.6g},{name}")
        write_text(draft / "front.csv", "\n".join(rows) + "\n")
        front_picture(np.array(values)).save(draft, "png")
    log.print(f"{len(found)} motions in {folder}")
    return found[0]


def _write(planner: Planner, best: Plan, scenario: str, out: Path) -> None:
    header = (
        f"# `cpid plan motion {scenario}` for {len(planner.targets)} plausible targets.\n"
        f"# The largest σ, weighted over these targets, is {best.score:.4g} in units of "
        "the scale. Units of this file: rad, m, s, Hz.\n\n"
    )
    write_text(out, header + dump_motion(planner.family.declare(best.parameters)))
