"""`cpid identify`."""

import time
from math import inf

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.report.mcap import write_mcap


def identify(
    logs: list[options.FileName],
    /,
    *,
    chosen: options.LogOptions = options.LogOptions(),
    json: options.File | None = None,
    report: options.File | None = None,
    mcap: options.File | None = None,
    seconds: options.Seconds = inf,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> int:
    """Identify the target that a spacecraft holds from logs of its motion.

    Exit codes: 0 all ten parameters are known, on a table the four that can be; 2 bad input or
    usage; 3 not all are determined; 4 a check failed: the first line says which.

    Args:
        logs: CSV, Parquet or ROS bag; several files of one log with + between them. Several
            logs of the same spacecraft and target give one estimate; each has its own start,
            momentum and biases.
        json: Write the result to this file.
        report: Write a report, one HTML page.
        mcap: Write estimates over time, residuals and events as ROS 2 messages.
        seconds: The trajectory fit ends after this time at the latest, with the result so far and
            a failed check. Default: no limit.

    """
    outputs = (("--json", json), ("--report", report), ("--mcap", mcap))
    requests = [chosen.request(each, logs) for each in logs]
    named = [file for each in requests for file in each.existing_files()]
    check_outputs(outputs, [*logs, *chosen.files(), *named], force=force)
    console = options.log_console()
    with options.log_console(quiet).status("identifying") as status:
        end = time.monotonic() + seconds

        def progress(step: str) -> bool:
            status.update(step)
            return time.monotonic() < end

        evidence = cpid.identify_files(requests, progress)
        result = evidence.result
        if json is not None:
            cpid.write_result(json, result)
        if report is not None:
            cpid.write_report(report, evidence, status.update)
        if mcap is not None:
            write_mcap(mcap, evidence)
    ignored = list(dict.fromkeys(name for file in evidence.files for name in file.ignored))
    if ignored:
        console.print(f"note: ignored columns: {', '.join(ignored[:20])}")
    return options.finish(result, quiet)
