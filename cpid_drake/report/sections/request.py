"""The section that repeats the request."""

from cpid_drake.identification.estimators import estimator_label
from cpid_drake.identification.result import Identification
from cpid_drake.report.page import Cell, Section, value_cell


def request_section(result: Identification) -> Section:
    """Return the section that shows the target, the data and the options of the identification."""
    sources = result.sources
    how = estimator_label(result.estimator) + (f" ({result.rows})" if result.rows else "")
    facts: list[tuple[str, str | Cell]] = []
    for source in sources:
        facts.append(("Telemetry", source.request.telemetry))
        facts.append(("Time window", f"{source.start:.6g} to {source.end:.6g} s"))
    for request in (source.request for source in sources[:1]):
        craft = request.spacecraft
        facts.append(("Sensors", request.sensors or "not given"))
        facts.append(("Total momentum", request.momentum or "not given"))
        facts += [("Prior", request.prior)] if request.prior else []
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
