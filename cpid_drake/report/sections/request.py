"""The section that repeats the request."""

from cpid_drake.identification.estimators import estimator_label
from cpid_drake.identification.result import Identification
from cpid_drake.report.page import Cell, Section, value_cell


def request_section(result: Identification) -> Section:
    """Return the section that shows the target, the data and the options of the identification."""
    sources, craft = result.sources, result.spacecraft
    how = estimator_label(result.estimator) + (f" ({result.rows})" if result.rows else "")
    facts: list[tuple[str, str | Cell]] = []
    for source in sources:
        facts.append(("Telemetry", source.telemetry))
        facts.append(("Time window", f"{source.start:.6g} to {source.end:.6g} s"))
    if sources:
        facts.append(("Sensors", sources[0].sensors or "not given"))
        facts.append(("Total momentum", sources[0].momentum or "not given"))
        facts += [("Prior", sources[0].prior)] if sources[0].prior else []
    if craft is not None:
        facts.append(("Spacecraft", craft.model))
        facts.append(("Base body", craft.base))
        facts.append(("Capture frame", craft.capture_frame))
    facts += [
        ("Estimator", how),
        ("Samples used", value_cell(result.sample_count, "sample_count")),
        ("Samples left out", str(sum(result.rejected.values()))),
    ]
    text = (
        "Mass, centre of mass and inertia of the target that a free-floating spacecraft holds, "
        "identified from the motion of the base while the arms move."
    )
    return Section("Request", texts=[text], facts=facts)
