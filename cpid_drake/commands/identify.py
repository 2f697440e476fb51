"""`cpid identify`."""

import math
import time
from pathlib import Path
from typing import Annotated

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.identification.description import describe
from cpid_drake.live.mcap import write_mcap


def identify(
    logs: Annotated[
        list[str],
        "LOG",
        f"{options.LOG_KINDS} Several logs of the same spacecraft and target give one "
        "estimate; each has its own start, momentum and biases.",
    ],
    chosen: options.LogOptions,
    json_file: Annotated[Path | None, "--json FILE", "Write the result to this file."] = None,
    report: Annotated[Path | None, "--report FILE", "Write a report, one HTML page."] = None,
    mcap: Annotated[
        Path | None,
        "--mcap FILE",
        "Write estimates over time, residuals and events as ROS 2 messages.",
    ] = None,
    seconds: Annotated[
        float,
        "The trajectory fit ends after this time at the latest, with the result so far "
        "and a failed check. Default: no limit.",
    ] = math.inf,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> int:
    """Identify the target that a spacecraft holds from logs of its motion.

    Exit codes: 0 all ten parameters are known, on a table the four that can be; 2 bad input or
    usage; 3 not all are determined; 4 a check failed: the first line says which.
    """
    outputs = (("--json", json_file), ("--report", report), ("--mcap", mcap))
    check_outputs(outputs, [*logs, *chosen.files()], force=force)
    requests = [chosen.request(each, logs) for each in logs]
    console = options.log_console()
    with options.log_console(quiet).status("identifying") as status:
        end = time.monotonic() + seconds

        def progress(step: str) -> bool:
            status.update(step)
            return time.monotonic() < end

        evidence = cpid.identify_files(requests, progress)
        result = evidence.found
        if json_file is not None:
            cpid.write_result(json_file, result)
        if report is not None:
            cpid.write_report(report, evidence, status.update)
        if mcap is not None:
            write_mcap(mcap, evidence)
    ignored = list(dict.fromkeys(name for file in evidence.files for name in file.ignored))
    if ignored:
        console.print(f"note: ignored columns: {', '.join(ignored[:20])}")
    options.print_warnings(result.warnings)
    if quiet:
        options.print_warnings([f"failed check: {failure}" for failure in result.failures])
    else:
        print("\n".join(describe(result)))
    return options.exit_code(result)
