"""The report of a simulated run, with an identification from its log."""

from dataclasses import replace

from cpid_drake.identification.identify_files import identify_files
from cpid_drake.identification.request import Request
from cpid_drake.report.findings import Findings, Progress, findings_of
from cpid_drake.report.page import Report, Section, Table
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.report.run_folder import Run


def run_report(run: Run, request: Request, progress: Progress) -> tuple[Report, Findings]:
    """Return the report of a run's folder, and the findings from its log.

    Args:
        run: the contents of the folder.
        request: the request to identify the run's log.
        progress: called before every step with a short description of it.

    Raises:
        InputError: for the same reasons as `identify_files`.

    """
    findings = replace(
        findings_of(identify_files([request], progress), progress),
        truth=run.truth,
        visual_model=run.scenario.target.visual_model,
    )
    report = identification_report(
        findings,
        before=(simulated_section(run),),
        title=f"Simulated run “{run.folder.resolve().name}”",
        progress=progress,
    )
    return replace(report, data={**report.data, **run.texts}), findings


def simulated_section(run: Run) -> Section:
    """Return the section with the simulated scenario and the online estimate at its end.

    Its warnings are the limits of the spacecraft that the joint motion exceeds.
    """
    scenario, about, drift = run.scenario, run.about, run.about.momentum_drift
    estimate = about.online_identification["estimate"]
    named = scenario.sensors.suite or "defined in the scenario"
    facts = [
        ("Spacecraft", scenario.spacecraft.model),
        ("Duration", f"{scenario.simulation.duration:g} s"),
        ("Mass of the target", f"{run.truth.mass:g} kg"),
        ("Joint motion", type(scenario.joint_motion).__name__),
        ("Sensors", named if scenario.sensors.present else "none (exact motion)"),
        ("Seed of the noise", "none" if about.sensor_seed is None else str(about.sensor_seed)),
        ("Online estimator", scenario.online_estimator.replace("_", " ")),
        ("Momentum drift", f"{drift['linear_N_s']:.2g} N·s, {drift['angular_N_m_s']:.2g} N·m·s"),
        ("Closest bodies", about.limits.closest or "not checked"),
    ]
    cells = ["not known" if value is None else f"{value:.4g}" for value in estimate.values()]
    return Section(
        "Simulation",
        facts=facts,
        tables=[Table(["", *estimate], [["online estimate", *cells]])],
        warnings=[f"The spacecraft cannot make this motion: {e}." for e in about.limits.exceeded],
    )
