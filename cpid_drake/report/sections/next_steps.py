"""What to do next: after failed checks, and where something is open; and the warnings."""

from cpid_drake.identification.description import gap
from cpid_drake.identification.result import Identification
from cpid_drake.report.page import Section

ADVICE = {
    "log": "write what the sentence says into a map of columns",
    "convergence": "cpid log check with --spacecraft",
    "share of outliers": "cut the log with --from and --to",
    "changes of the momentum": (
        "give the log of thrust; declare wheel, target_wheel or compliance_urad"
    ),
    "correlation of": "declare delay_ms; log raw samples; move more slowly",
    "noise": "state the noise of your sensors; look at the residuals in the report",
    "halves": "identify each half alone; declare acceleration and torque",
    "random walks": "log what acts, or state torque_noise, acceleration_noise",
    "changing torque": "hold it fast, log what acts, or state torque_noise",
    "oscillation": "hold it fast, or log it",
    "declared sizes": (
        "state what the hardware can have, as joint_scale_ppm of belts; else look for a sign or an "
        "axis"
    ),
    "errors held exact": "state its σ in the sensors' file, or leave unstated: exact out",
    "momentum": "--momentum unknown",
    "bias by noise in rows": "--estimator trajectory_fit with --sensors",
    "conservation of momentum": (
        "--estimator trajectory_fit with --sensors; time_step=0, accuracy 1e-8, no gravity"
    ),
    "forces": "--estimator trajectory_fit",
    "thrust": "use recursive_fit online, trajectory_fit for a log",
    "distance of the nearest rigid body": "check mass and inertia of each body of the model",
    "uncertainty": "check the units",
    "rejected share of": "cpid log check names the lines, and counts repeated stamps",
    "linearity": "--estimator trajectory_fit",
    "agreement": "give each log its own sensors",
    "prior": "identify the earlier log again, or leave the prior out",
}
"""What to do if a check failed, by the beginning of its name; also in docs/how-to/symptoms.md."""


def next_sections(result: Identification, warnings: list[str]) -> list[Section]:
    """Return the sections with advice for each failed check and what is open, and with warnings.

    The page's subtitle has the sentence of the first failed check.
    """
    facts = list[tuple[str, str]]()
    for check in result.checks:
        if not check.passed:
            advice = (text for name, text in ADVICE.items() if check.name.startswith(name))
            sentence = f"{check.sentence}: " if facts else ""
            facts.append((check.name, sentence + next(advice, "see the documentation")))
    sections = [Section("What to do next", texts=gap(result), facts=facts)]
    sections = [each for each in sections if each.texts or each.facts]
    return sections + ([Section("Warnings", warnings=warnings)] if warnings else [])
