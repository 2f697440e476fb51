"""`cpid plan`: plans a joint motion, ranks motions, and exports one for a robot's controller."""

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_type_hints

from cyclopts import Group, Parameter
from cyclopts.validators import Number as Within

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.commands.groups import group
from cpid_drake.files.digits import significant
from cpid_drake.files.errors import prefix_errors
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.files.resources import find_scenario
from cpid_drake.planning.plan_options import PlanOptions

if TYPE_CHECKING:  # Drake and SciPy take a second to load, and help needs neither
    from cpid_drake.planning.planner import Planner

plan = group("plan")

_KNOWN = Parameter(group=Group.create_ordered("What is known"))
_GROUPS = {
    "The motion": ("duration", "opportunistic", "frequency", "joint"),
    "Limits": (
        "rate_share",
        "acceleration",
        "clearance",
        "base_attitude",
        "base_rate",
        "base_displacement",
    ),
    "The search": ("targets", "candidates", "iterations", "seed"),
}
"""The groups of the planner's options in the help."""


@Parameter("*")
@dataclass(frozen=True)
class Choices(PlanOptions):
    """The options of a plan and of a comparison."""

    sensors: Annotated[options.Sensors | None, _KNOWN] = None
    """Sensors. Default: the scenario's, else flight."""
    prior: Annotated[options.File | None, _KNOWN] = None
    """What is known about the target: a result of `cpid identify` (JSON), or YAML with mass,
    p_CTcm_C, I_TTcm_C and sigma. Default: nothing but the spacecraft's size."""

    def planner(self, scenario: Path | str) -> "Planner":
        """Return the planner of a scenario's file."""
        from cpid_drake.planning.planner import load_planner

        return load_planner(scenario, self.sensors, self, self.prior)


# The planner knows no command line: the groups and placeholders of its options are added here.
for _title, _names in _GROUPS.items():
    _group = Group.create_ordered(_title)
    for _name in _names:
        _kind = get_type_hints(PlanOptions)[_name]
        _metavar = "NAME" if _name == "joint" else "COUNT" if _kind is int else "NUMBER"
        Choices.__annotations__[_name] = Annotated[_kind, Parameter(group=_group, metavar=_metavar)]


@plan.command
def motion(
    scenario: options.Scenario,
    /,
    *,
    out: options.File,
    chosen: Choices = Choices(),
    report: options.File | None = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Plan an exciting joint motion: one that determines the target best.

    The motion has the start and the end of the scenario's own motion. The planner does not use the
    target's mass properties in the scenario. Ctrl-C keeps the best motion so far.

    Args:
        out: YAML file of the planned motion.
        report: HTML page with σ, joints and base of the plan.

    """
    from cpid_drake.planning.comparison import predictions
    from cpid_drake.planning.plan_file import write_plan
    from cpid_drake.report.pages.plan_page import plan_report
    from cpid_drake.report.plan_tables import motion_table
    from cpid_drake.report.terminal import print_table

    path, start = find_scenario(scenario), time.perf_counter()
    check_outputs([("--out", out), ("--report", report)], [path, chosen.prior], force=force)
    log = options.log_console(quiet)
    with prefix_errors(scenario), log.status("planning") as status:

        def progress(what: str, best: float = math.nan) -> None:
            score = "" if math.isnan(best) else f": worst σ {significant(100 * best, 3)} % of scale"
            status.update(f"{what}{score}")

        planner = chosen.planner(path)
        best = write_plan(out, planner, scenario, progress=progress)
        log.print(f"{out}: {time.perf_counter() - start:.0f} s")
        motions = {"scenario's motion": planner.own_motion, "plan": best.motion}
        predicted = predictions(planner, motions)
    usage = predicted["scenario's motion"].usage
    limit = max(usage, key=lambda name: usage[name])
    if usage[limit] > 1:
        planner.notes.append(
            "with some of the plausible targets the scenario's motion needs "
            f"{significant(usage[limit])} times the limit: {limit}"
        )
    elif predicted["scenario's motion"].worst < predicted["plan"].worst:
        planner.notes.append(
            "the scenario's motion keeps the limits and determines the target better than the "
            "plan: keep it, or plan with a higher --frequency or more --candidates"
        )
    for note in planner.notes:
        log.print(f"note: {note}")
    title = f"Predicted σ, a target of {planner.targets[0][0]:.3g} kg"
    table, active = motion_table(predicted, title), "; ".join(best.active) or "none"
    if report is not None:
        facts = [("Scenario", str(scenario)), ("Plan", str(out)), ("Active limits", active)]
        plan_report(planner, motions, predicted, table, facts).write(report)
    if quiet:
        return
    print_table(table)
    print(f"active limits: {active}")
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
    from cpid_drake.planning.comparison import predictions, reference_motions
    from cpid_drake.report.plan_tables import motion_table, rank_correlation
    from cpid_drake.report.terminal import print_table
    from cpid_drake.simulation.joint_motions import MotionFile

    path, log = find_scenario(scenario), options.log_console(quiet)
    with prefix_errors(scenario), log.status("ranking") as status:
        planner = chosen.planner(path)
        craft, still = planner.spacecraft, planner.scenario.spacecraft.configuration
        given = {file.name: MotionFile(str(file)).make(craft, still) for file in motions or []}
        compared = {**dict(reference_motions(planner)), **given}
        predicted = predictions(planner, compared, trials, status.update)
    for note in planner.notes:
        log.print(f"note: {note}")
    ordered = dict(sorted(predicted.items(), key=lambda item: item[1].worst))
    title = f"Motions for a target of {planner.targets[0][0]:.3g} kg, the best first"
    print_table(motion_table(ordered, title))
    if trials:
        correlation = rank_correlation(predicted)
        print(f"rank correlation of predicted and realised errors: {correlation:.2f}")


@plan.command
def export(
    scenario: options.Scenario,
    motion: Path,
    /,
    *,
    out: options.File,
    rate: Annotated[options.Rate, Parameter(validator=Within(gte=0.1, lte=1e4))] = 100.0,
    force: options.Force = False,
) -> None:
    """Write a joint motion as CSV: time, positions, rates and accelerations of all joints.

    Args:
        motion: YAML file of a motion of the scenario's spacecraft.
        out: CSV file to write.
        rate: Rows per second.

    """
    from cpid_drake.simulation.joint_motions import MotionFile, write_joint_table

    path = find_scenario(scenario)
    check_outputs([("--out", out)], [path, motion], force=force)
    config = cpid.load_scenario(path).spacecraft
    craft = config.make()
    made = MotionFile(str(motion)).make(craft, config.configuration)
    write_joint_table(out, made, craft.joint_names, rate)
