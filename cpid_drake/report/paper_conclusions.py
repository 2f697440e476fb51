"""What the paper's study shows, in sentences with the numbers of the run."""

import numpy as np

from cpid_drake.studies.paper import PaperStudy
from cpid_drake.studies.paper_values import PAPER_DIGITS, PAPER_FIGURE_7, PAPER_TABLE_2
from cpid_drake.studies.parameter_errors import max_relative_error
from cpid_drake.studies.rounding import RoundedCase, base_speed


def conclusions(study: PaperStudy) -> list[str]:
    """Return the conclusions of all tables."""
    return [*_exact(study), *_decimals(study), *_instants(study), *_resimulation(study)]


def _exact(study: PaperStudy) -> list[str]:
    error = max_relative_error(study.exact.parameters, study.truth)
    return [
        f"{len(study.samples)} exact samples determine all ten parameters with a relative error of "
        f"at most {error:.1e}; the method is exact, and the rest is the error of the integration."
    ]


def _decimals(study: PaperStudy) -> list[str]:
    bad = [str(case.decimals) for case in study.rounded if case.objection]
    sentences = []
    if bad:
        sentences.append(
            "The half cosine of Fig. 5, with our spacecraft and joint angles, gives no answer from "
            f"data of {listed(bad)} decimals; Table 2 marks these values."
        )
    speed, share = base_speed(study.samples), study.share
    step = 10.0**-share.decimals
    sentences.append(
        f"The cause is the slow base: our spacecraft of {study.simulation.spacecraft.mass:.0f} kg "
        f"holds a target of {study.truth.mass:.0f} kg, and its base moves at {speed:.3f} m/s at "
        f"most, {speed / step:.0f} steps of {share.decimals} decimals. With "
        f"{share.decimals} decimals the error of the mass is {share.all_rounded:+.2g} kg; it is "
        f"{share.velocity_rounded:+.2g} kg if only the base's velocity is rounded, and "
        f"{share.others_rounded:+.2g} kg if all other values are."
    )
    if study.is_papers_target:
        sentences += _against_the_paper(study)
    return sentences


def _against_the_paper(study: PaperStudy) -> list[str]:
    theirs = {d: abs(mass - study.truth.mass) for d, mass in PAPER_TABLE_2.items()}
    ours = {case.decimals: _error(case, study) for case in study.rounded}
    nearer = [d for d in theirs if not ours[d] <= theirs[d]]
    sentences = []
    if nearer:
        ratios = [ours[d] / theirs[d] for d in nearer if np.isfinite(ours[d])]
        text = f"At {listed([str(d) for d in nearer])} decimals the paper's mass is nearer"
        if ratios:
            text += f", by a factor of up to {max(ratios):.0f}"
        sentences.append(
            f"{text}. The paper gives neither the masses of its spacecraft nor its joint angles. "
            "As the error is proportional to the step of the rounding over the base's speed, its "
            "spacecraft was probably lighter, or its motion livelier, by about this factor."
        )
    plateau = theirs[max(theirs)]
    first = next(d for d in sorted(theirs) if ours[d] < plateau and not _objection(study, d))
    sentences.append(
        f"From {first} decimals on, ours is nearer: it improves with every decimal, while the "
        f"paper's error stays at {plateau:.2g} kg. Rounding does not cause this plateau."
    )
    if study.livelier is not None:
        fits = {case.decimals: case for case in study.livelier.by_fit}
        worse = [str(d) for d in theirs if not _error(fits[d], study) <= theirs[d]]
        verdict = (
            f"at every number of decimals but {listed(worse)}"
            if worse
            else "at every number of decimals"
        )
        ratio = study.livelier.base_speed / base_speed(study.samples)
        refused = [str(d) for d, case in fits.items() if case.objection]
        text = (
            f"With a livelier motion of the same arms, at {study.livelier.rate_share:.0%} of their "
            f"rate limits at most, the base moves "
            f"{ratio:.1f} times as fast; all samples together give a mass that is as near as the "
            f"paper's or nearer {verdict}"
        )
        if refused:
            text += f"; at {listed(refused)} it is refused nevertheless"
        sentences.append(f"{text}.")
    return sentences


def _error(case: RoundedCase, study: PaperStudy) -> float:
    return abs(case.mass - study.truth.mass)


def _objection(study: PaperStudy, decimals: int) -> str:
    return study.rounded_to(decimals).objection


def _instants(study: PaperStudy) -> list[str]:
    sentences = []
    incomplete = [sets.n for sets in study.sets if sets.complete == 0]
    complete = [
        sets
        for sets in study.sets
        if sets.complete == sets.count and np.isfinite(sets.disagreement)
    ]
    if incomplete:
        sentences.append(
            f"The paper says that two instants suffice. No set of {max(incomplete)} instants "
            "determines all ten parameters."
        )
    if complete:
        exact = max(sets.disagreement for sets in complete)
        fewest, most = complete[0], complete[-1]
        sentences.append(
            "The paper says that all sets of instants give the same result. They do with exact "
            f"data: {sum(sets.complete for sets in complete)} sets of {fewest.n} instants or "
            f"more agree within {exact:.1e} of the scale. With {PAPER_DIGITS} decimals, sets of "
            f"{fewest.n} differ by up to {fewest.disagreement_rounded:.1e}, and sets of {most.n} "
            f"by up to {most.disagreement_rounded:.1e}."
        )
    for sets in study.sets:
        if 0 < sets.complete < sets.count:
            sentences.append(
                f"{sets.complete} of {sets.count} sets of {sets.n} instants determine all ten; "
                f"some do barely, and the sets differ by up to {sets.disagreement:.1e}."
            )
    period = study.simulation.scenario.identification.period
    sentences.append(
        "The paper says that the computing time can be ignored. One update takes "
        f"{1e6 * study.update_seconds:.0f} µs on this machine, {study.update_seconds / period:.3%} "
        "of the time between two samples."
    )
    return sentences


def _resimulation(study: PaperStudy) -> list[str]:
    attitude, position = study.max_attitude_relative_error, study.max_position_relative_error
    text = (
        "A simulation with the parameters from 6 decimals moves the base with an error of at most "
        f"{attitude:.4%} in attitude and {position:.4%} in position"
    )
    if study.is_papers_target:
        theirs = PAPER_FIGURE_7
        text += f" (paper: {theirs['attitude']:.2%} and {theirs['position']:.2%})"
    return [f"{text}."]


def listed(names: list[str]) -> str:
    """Return names as a list in words."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
