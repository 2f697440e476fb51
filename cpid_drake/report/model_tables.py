"""A model's summary as tables for the terminal, and the command to go on with."""

import shlex

import numpy as np

from cpid_drake.report.page import Table
from cpid_drake.spacecraft.model_summary import ModelSummary

MOST_FRAMES = 12
"""Most frames on offer that are shown."""


def facts(summary: ModelSummary) -> list[str]:
    """Return what the model is, in sentences."""
    craft = summary.spacecraft
    followers = craft.coupling.joints[craft.coupling.count :]
    joints = f"{len(craft.joint_names)} joints"
    if followers:
        joints += f", and {len(followers)} that follow them"
    offered = [f"{name} ({count})" for name, count in summary.frames.items()]
    more = len(offered) - MOST_FRAMES
    shown = ", ".join(offered[:MOST_FRAMES]) + (f" and {more} more" if more > 0 else "")
    return [
        f"{craft.path}: {joints}, {len(craft.tree.bodies)} bodies, {craft.mass:.6g} kg",
        f"base: {summary.base}",
        f"capture frame: {summary.capture_frame}",
        f"on offer, with the number of joints that carry it: {shown}",
        *craft.file.notes,
    ]


def joint_table(summary: ModelSummary) -> Table:
    """Return the joints with their limits, and those that follow others."""
    craft, rows = summary.spacecraft, []
    limits, sliding = craft.limits, craft.tree.sliding
    for k, name in enumerate(craft.joint_names):
        unit, effort = ("m", "N") if k in sliding else ("rad", "N·m")
        ends = [_number(value) for value in (limits.lowest[k], limits.highest[k])]
        rates = [f"{_number(limits.rates[k])} {unit}/s", f"{_number(limits.efforts[k])} {effort}"]
        role = "carries C" if k in craft.tree.carrying else ""
        role = "wheel" if craft.tree.is_rotor(k) and not role else role
        rows.append([name, *ends, unit, *rates, role])
    for body in craft.tree.bodies:
        if body.follows and body.joint >= 0:
            leader = craft.joint_names[body.joint]
            text = f"follows {leader}, times {body.multiplier:.4g}"
            rows.append([body.joint_name, "", "", "", "", "", text])
    return Table(["joint", "lowest", "highest", "", "rate", "effort", ""], rows, "Joints")


def body_table(summary: ModelSummary) -> Table:
    """Return the masses of the bodies, and their radii of gyration."""
    rows = []
    for body in summary.spacecraft.tree.bodies:
        moments = np.linalg.eigvalsh(body.I_BBcm)
        radius = np.sqrt(max(moments[-1], 0.0) / body.mass) if body.mass > 0 else 0.0
        sizes = [f"{moment:.4g}" for moment in moments]
        rows.append([body.name, f"{body.mass:.6g}", *sizes, f"{radius:.3g}"])
    heads = ["body", "mass [kg]", "principal moments", "", "[kg·m²]", "gyration [m]"]
    return Table(heads, [row for row in rows if row[1] != "0"], "Bodies with a mass")


def finding_table(summary: ModelSummary) -> Table:
    """Return the bodies that cannot be, or hardly are these links."""
    rows = [
        [each.link, "impossible" if each.impossible else "implausible", each.figure, each.possible]
        for each in summary.findings
    ]
    note = ""
    if summary.spacecraft.file.impossible:
        note = (
            "Commands refuse the impossible ones without --repair-bodies nearest; the nearest "
            "bodies are in the table above."
        )
    return Table(["link", "", "figure", "what is possible"], rows, "Bodies to correct", note)


def next_command(summary: ModelSummary, model: str) -> str:
    """Return the command that identifies a log with this model."""
    words = ["cpid", "identify", "LOG", "--model", model, "--base", summary.base]
    words += ["--capture-frame", summary.capture_frame]
    for name, folder in summary.packages.items():
        words += ["--package", f"{name}={folder}"]
    if summary.spacecraft.file.impossible:
        words += ["--repair-bodies", "nearest"]
    return shlex.join(words)


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "none"
