"""The section with the replay in three dimensions."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rows import row_family
from cpid_drake.identification.by_rows import complete_samples
from cpid_drake.identification.checked_log import in_joint_order
from cpid_drake.identification.identify_files import Evidence
from cpid_drake.logs.noise_estimation import estimate_suite
from cpid_drake.logs.screening import screen
from cpid_drake.logs.smoothing import smooth
from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Section, embedded_json
from cpid_drake.report.replay import replay_html

_MOST, _LONGEST = 20_000, 60.0
"""Number of samples of one sensor above which only the first minute [s] is shown."""


def replay_section(findings: Findings, evidence: Evidence) -> Section:
    """Return the section with the replay of a log and of its estimates.

    Raises:
        InputError: the log does not determine the motion of the base.

    """
    motion = motion_of(evidence)
    page = replay_html(
        evidence.inputs.spacecraft,
        motion,
        findings.estimates,
        truth=findings.truth,
        visual_model=findings.visual_model,
        title=Path(evidence.log.source.request.telemetry).name,
    )
    text = "The motion in three dimensions, with the estimate over time."
    if evidence.log.data.interval[1] > motion.time[-1] + _LONGEST / 2:
        text += f" The log is long: these are its first {motion.time[-1] - motion.time[0]:.4g} s."
    return Section("Replay", texts=[text], inner_page=embedded_json(json.dumps(page)))


def motion_of(evidence: Evidence) -> Motion:
    """Return the motion in a log: its complete samples or, if there are none, the smoothed motion.

    Of a long log, it is the motion in the first minute.

    Raises:
        InputError: the log has too few samples, or a sensor that smoothing needs is missing.

    """
    beginning = evidence.log.data
    if max(len(samples) for _, samples in beginning.items()) > _MOST:
        beginning = beginning.between(0.0, _LONGEST)
    measurements = screen(in_joint_order(beginning, evidence.inputs.spacecraft)).measurements
    if len(measurements.attitude):
        with_relative = () if len(measurements.position) else ("relative",)
        for rows in ("standard", *with_relative):
            complete = complete_samples(measurements, row_family(rows))
            if complete is not None:
                return complete
    suite = evidence.found.sensors or estimate_suite(measurements)
    with_position = bool(len(measurements.position))
    return _with_inner_rates(smooth(measurements, suite, with_position=with_position).telemetry)


def _with_inner_rates(motion: Motion) -> Motion:
    """Return a smoothed motion with the rates of the neighbours at its first and last sample.

    A spline's rates at its ends are known from one side only, and their noise looks like momentum.
    """
    if len(motion) < 3:
        return motion
    inner = np.arange(len(motion)).clip(1, len(motion) - 2)
    rates = {name: getattr(motion, name)[inner] for name in ("v_WB", "w_WB", "qdot")}
    return replace(motion, **rates)
