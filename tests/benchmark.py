#!/usr/bin/env python3
"""Speed: figures and their limits; `--write` renews docs/explanation/speed.md.

A count depends on no machine, and fails beyond its limit. A ratio is a time of the processor,
divided by that of a reference in the same interpreter. It fails beyond twice its limit, and only if
a second interpreter agrees, so that a busy machine fails nothing. For the same reason the reference
is Drake's own calls: other processes slow them as they slow what is measured, and hardly slow a QR
decomposition of a large matrix.
"""

import argparse
import json
import resource
import statistics
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from types import FrameType

import numpy as np
from processes import ROOT, finish, start

import cpid_drake as cpid
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.estimation.least_squares import sum_of_triangles, triangle, updated_information
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.logs.log import ideal_log
from cpid_drake.logs.simulated_noise import add_noise

COUNT, RATIO = 1.0, 2.0
"""Kinds of figures: the factor of its limit beyond which one fails."""

DRAKE, NUMPY = "× Drake's calls", "× import of NumPy"
"""References: state set, pose and velocity of C, momentum; a new interpreter that imports NumPy."""

CALLS, QRS, LINEAR, MODULES = "functions called", "QRs", "linearizations", "loaded"
SUMS = "sums of two triangles"
"""What is counted: calls of functions of the package, and of those of `COUNTED`; modules loaded."""


@dataclass(frozen=True)
class Figure:
    """A figure of something, its unit and its limit, and its kind."""

    of: str
    unit: str
    limit: float
    kind: float


SAMPLE = "`MomentumIdentifier`, 12 joints: a sample"
OUTPUTS = "the same, `parameters` and `covariance` read after it"
UPDATE = "its QR decomposition alone"
LOADED, ALL_LOADED = "building it: modules of the package", "building it: all modules"
DIAGRAM = "10 s of the paper's Diagram, simulated"
PROPAGATION = "the same motion, propagated for 300 targets"
EXACT = "`OnlineIdentifier`, 12 joints, `flight`, `unstated: exact`: a second"
SHIPPED = "`OnlineIdentifier`, 12 joints, `flight`: a second"
LONGEST = "{}, the longest call of `add`"
IDENTIFY = "`identify` of the README's log"
HELP, HELP_LOADED = "`cpid --help`", "`cpid --help`: modules of the package"

FIGURES = (
    Figure(SAMPLE, DRAKE, 12, RATIO),
    Figure(SAMPLE, CALLS, 10.07, COUNT),
    Figure(OUTPUTS, DRAKE, 30, RATIO),
    Figure(OUTPUTS, CALLS, 33.01, COUNT),
    Figure(UPDATE, DRAKE, 1, RATIO),
    Figure(LOADED, MODULES, 50, COUNT),
    Figure(ALL_LOADED, MODULES, 700, RATIO),  # Drake's, NumPy's and SciPy's change by version
    Figure(DIAGRAM, DRAKE, 320_000, RATIO),
    Figure(PROPAGATION, DRAKE, 40_000, RATIO),
    Figure(EXACT, DRAKE, 7_000, RATIO),
    Figure(LONGEST.format(EXACT), DRAKE, 20_000, RATIO),
    Figure(EXACT, CALLS, 5_400, COUNT),
    Figure(EXACT, LINEAR, 1, COUNT),
    Figure(EXACT, QRS, 24.5, COUNT),
    Figure(EXACT, SUMS, 5, COUNT),
    Figure(SHIPPED, DRAKE, 20_000, RATIO),
    Figure(LONGEST.format(SHIPPED), DRAKE, 70_000, RATIO),
    Figure(SHIPPED, CALLS, 10_300, COUNT),  # another BLAS may need one more sweep of a block
    Figure(SHIPPED, LINEAR, 2, COUNT),
    Figure(SHIPPED, QRS, 36, COUNT),
    Figure(SHIPPED, SUMS, 8, COUNT),
    Figure(IDENTIFY, DRAKE, 80_000, RATIO),
    Figure(IDENTIFY, CALLS, 40_000, COUNT),
    Figure(IDENTIFY, LINEAR, 30, COUNT),
    Figure(IDENTIFY, QRS, 430, COUNT),
    Figure(IDENTIFY, SUMS, 110, COUNT),
    Figure(HELP, NUMPY, 2.5, RATIO),
    Figure(HELP_LOADED, MODULES, 7, COUNT),
)

Measured = dict[tuple[str, str], float]
"""Times [s] or counts, by what they are of and their unit; a reference is of its unit."""


# -- clocks and counters --------------------------------------------------------------------------


def processor_time() -> float:
    """Return the time of the processor for this process and those that it started [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + used.ru_utime + used.ru_stime


def seconds(work: Callable[[], object]) -> float:
    """Return the time of the processor for a call [s]."""
    begin = processor_time()
    work()
    return processor_time() - begin


def medians(
    unit: str, rounds: int, works: Mapping[str, tuple[Callable[[], object], int]]
) -> Measured:
    """Return median times of works, each with how often it does what it does, in turn [s]."""
    times = defaultdict(list)
    for of, (work, repetitions) in rounds * list(works.items()):
        times[of, unit].append(seconds(work) / repetitions)
    return {key: statistics.median(each) for key, each in times.items()}


COUNTED = {
    BlockModel.jacobian.__code__: (LINEAR,),
    sum_of_triangles.__code__: (SUMS,),
    triangle.__code__: (QRS,),
    updated_information.__code__: (QRS,),
}


def counted(of: str, work: Callable[[], object], repetitions: int = 1) -> Measured:
    """Return how many functions of the package a work calls, and which of those of `COUNTED`."""
    folder, counts = str(Path(cpid.__file__).parent), Counter[str]()

    def count(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(folder):
            counts.update(COUNTED.get(frame.f_code, ()))
            counts[CALLS] += 1

    sys.setprofile(count)
    try:
        work()
    finally:
        sys.setprofile(None)
    return {(of, unit): n / repetitions for unit, n in counts.items()}


def modules(code: str) -> list[str]:
    """Return the modules that a new interpreter has loaded after some code."""
    report = "import atexit, sys; atexit.register(lambda: print(*sys.modules, file=sys.stderr)); "
    done = finish(start("-c", report + code, cwd=ROOT))
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stderr.splitlines()[-1].split()


def of_package(names: Iterable[str]) -> int:
    """Return the number of modules of the package."""
    return sum(name.partition(".")[0] == cpid.__name__ for name in names)


# -- groups of figures ----------------------------------------------------------------------------


def scenario_of(name: str) -> cpid.Scenario:
    """Return a shipped scenario."""
    return cpid.load_scenario(f"package://cpid_drake_models/scenarios/{name}.yaml")


def paper_states(count: int = 100) -> tuple[cpid.Spacecraft, np.ndarray]:
    """Return the paper's spacecraft and states x = [q; v] (count, nx) of its motion."""
    scenario = scenario_of("paper")
    craft, times = scenario.spacecraft.make(), np.linspace(0.1, 9.9, count)
    joints, truth = scenario.make_joint_motion(craft), scenario.target_truth()
    return craft, craft.to_states(craft.predicted_motion(truth, joints, times))


def drakes_calls() -> tuple[Callable[[], object], int]:
    """Return the reference `DRAKE`, and how often it calls; once is too short to measure."""
    craft, states = paper_states()
    plant, context = craft.plant, craft.plant.CreateDefaultContext()

    def work() -> None:
        for state in (*states,) * 10:
            plant.SetPositionsAndVelocities(context, state)
            p_WC = craft.capture_frame.CalcPoseInWorld(context).translation()
            craft.capture_frame.CalcSpatialVelocityInWorld(context)
            plant.CalcSpatialMomentumInWorldAboutPoint(context, p_WC)

    return work, 10 * len(states)


def momentum_identifier() -> Measured:
    """Measure samples of the paper's motion, each of a state of its own."""
    craft, states = paper_states()
    identifier = cpid.MomentumIdentifier(craft, rows="eq18")
    context = identifier.CreateDefaultContext()
    port = identifier.GetInputPort("state").FixValue(context, states[0])
    outputs = [identifier.GetOutputPort(name) for name in ("parameters", "covariance")]
    rows = np.random.default_rng(0).normal(size=(6, 11))

    def sample(is_read: bool) -> None:
        for state in states:
            port.GetMutableData().get_mutable_value().SetFromVector(state)
            context.SetTime(context.get_time() + 1.0)
            context.SetDiscreteState(identifier.EvalUniquePeriodicDiscreteUpdate(context))
            for output in outputs if is_read else ():
                output.Eval(context)

    def update() -> None:
        root = np.zeros((11, 11))
        for _ in states:
            root = updated_information(root, rows)

    works = {SAMPLE: partial(sample, False), OUTPUTS: partial(sample, True)}
    counts = [counted(of, work, len(states)) for of, work in works.items()]
    timed = {of: (work, len(states)) for of, work in (works | {UPDATE: update}).items()}
    return medians(DRAKE, 15, {DRAKE: drakes_calls()} | timed) | counts[0] | counts[1]


def imports() -> Measured:
    """Count the modules that building a `MomentumIdentifier` loads."""
    model = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"
    spacecraft = f"cpid.Spacecraft({model!r}, base='bus', capture_frame='capture_point')"
    names = modules(f"import cpid_drake as cpid; cpid.MomentumIdentifier({spacecraft})")
    return {(LOADED, MODULES): of_package(names), (ALL_LOADED, MODULES): len(names)}


def simulation() -> Measured:
    """Measure the paper's motion, simulated and propagated."""
    paper = cpid.make_simulation(scenario_of("paper"))
    targets = np.tile(paper.truth.to_standard_vector(), (300, 1))
    motion = partial(propagate, paper.spacecraft.tree, paper.joint_motion, targets, np.arange(11.0))
    works = {DRAKE: drakes_calls(), PROPAGATION: (motion, 1)}
    return medians(DRAKE, 5, works) | medians(DRAKE, 1, {DIAGRAM: (paper.run, 1)})


def online(of: str, unstated: str | None) -> Measured:
    """Measure each of 12 seconds of samples, and count in 4 more; from the ninth all are alike."""
    scenario, timed, end = scenario_of("exciting_motion"), 12, 16
    craft, truth = scenario.spacecraft.make(), scenario.target_truth()
    joints = replace(scenario.make_joint_motion(craft), duration=end + 4.0)
    suite = cpid.load_sensors("flight", unstated=unstated)
    moved = partial(craft.predicted_motion, truth, joints)
    log = add_noise(suite, ideal_log(suite, craft.joint_names, moved, float(end)), seed=1)
    identifier, (reference, calls) = cpid.OnlineIdentifier(craft, suite), drakes_calls()
    times, references, last = [], [], []
    for second, messages in groupby(log.messages(), lambda message: int(message[1])):
        works = [partial(identifier.add, *message) for message in messages]
        if second < timed:
            times.append([seconds(work) for work in works])
            references.append(seconds(reference) / calls)
        elif second < end:
            last += works
    counts = counted(of, lambda: [work() for work in last], end - timed)
    return counts | {
        (DRAKE, DRAKE): statistics.median(references),
        (of, DRAKE): statistics.median(map(sum, times[8:])),
        (LONGEST.format(of), DRAKE): max(map(max, times)),
    }


def identify() -> Measured:
    """Measure the identification of the README's log."""
    folder = ROOT / "models/telemetry"
    craft = cpid.load_spacecraft("free_flyer_payload").make()
    log = cpid.read_log(folder / "free_flyer.csv")
    sensors = cpid.load_sensors(folder / "free_flyer_sensors.yaml")
    work = partial(cpid.identify, craft, log, sensors=sensors)
    counts = counted(IDENTIFY, work)
    return medians(DRAKE, 3, {DRAKE: drakes_calls(), IDENTIFY: (work, 1)}) | counts


def start_up() -> Measured:
    """Measure `cpid --help`."""
    works = {
        NUMPY: (lambda: finish(start("-c", "import numpy", cwd=ROOT)), 1),
        HELP: (lambda: finish(start("-m", "cpid_drake", "--help", cwd=ROOT)), 1),
    }
    names = modules("sys.argv[1:] = ['--help']; import cpid_drake.__main__")
    return medians(NUMPY, 5, works) | {(HELP_LOADED, MODULES): of_package(names)}


GROUPS: dict[str, Callable[[], Measured]] = {
    "momentum_identifier": momentum_identifier,
    "imports": imports,
    "simulation": simulation,
    "online_exact": partial(online, EXACT, "exact"),
    "online_as_shipped": partial(online, SHIPPED, None),
    "identify": identify,
    "start_up": start_up,
}


# -- judgement and page ---------------------------------------------------------------------------


def measure(group: str) -> Measured:
    """Measure a group in a new interpreter; return its figures, and times with the unit "s"."""
    done = finish(start(__file__, "--group", group, cwd=ROOT))
    if done.returncode:
        raise SystemExit(done.stderr)
    measured = {(of, unit): value for of, unit, value in json.loads(done.stdout)}
    times = {(of, "s"): t for (of, unit), t in measured.items() if (unit, unit) in measured}
    return times | {key: t / measured.get((key[1], key[1]), 1.0) for key, t in measured.items()}


def is_beyond(figure: Figure, value: float) -> bool:
    """Return whether a value is beyond a limit, or nothing: then it is not counted any more."""
    return not 0 < value <= figure.kind * figure.limit


def failures(repetitions: Sequence[Measured]) -> Iterator[str]:
    """Yield a line for each figure that is beyond its limit in all repetitions that have it."""
    for figure in FIGURES:
        key = figure.of, figure.unit
        values = [measured[key] for measured in repetitions if key in measured]
        if all(is_beyond(figure, value) for value in values):
            limit = f"{'twice ' if figure.kind == RATIO else ''}its limit of {figure.limit:,.10g}"
            shown = ", again ".join(rounded(value, 6) for value in values)
            yield f"{figure.of}: {shown} {figure.unit}, beyond {limit}"


def rounded(value: float, digits: int = 2) -> str:
    """Return a number with so many digits."""
    return f"{float(f'{value:.{digits}g}'):,.10g}"


def duration(time: float) -> str:
    """Return a time [s] with its unit."""
    units = {"s": 1.0, "ms": 1e-3, "µs": 1e-6}
    name, size = next((name, size) for name, size in units.items() if time >= size)
    return f"{rounded(time / size)} {name}"


def rows(measured: Measured) -> Iterator[str]:
    """Yield the rows of the table of figures, those of the references first."""
    shown: dict[str, list[str]] = {DRAKE: [], NUMPY: []}
    for figure in FIGURES:
        text = rounded(measured[figure.of, figure.unit], 2 if figure.kind == RATIO else 5)
        shown.setdefault(figure.of, []).append(f"{text} {figure.unit}")
    for of, texts in shown.items():
        time = duration(measured[of, "s"]) if (of, "s") in measured else ""
        yield f"| {of.removeprefix('× ')} | {time} | {'; '.join(texts)} |"


PAGE = ROOT / "docs/explanation/speed.md"
INTRODUCTION = """\
# How fast

`make benchmark WRITE=--write` has written this page. `make benchmark` measures the figures on
your machine, and fails if one is beyond its limit. The times are those of one processor.

"Drake's calls" set a state of 12 joints and compute pose and velocity of C, and the momentum. Times
relative to them change little with the machine, and counts do not change. "A second" is all work
for the samples of a second, after the first eight. A block is a second long.

"""
HEADER = ("| What | Processor time | Relative to a reference; counts |", "|---|---|---|")


def main() -> None:
    """Measure all groups, and those of a ratio beyond its limit again; print and judge them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--group", choices=GROUPS, help="measure this one alone, as JSON")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)}")
    arguments = parser.parse_args()
    if arguments.group:
        measured = GROUPS[arguments.group]()
        print(json.dumps([(*key, value) for key, value in measured.items()]))
        return
    groups = {name: measure(name) for name in GROUPS}
    first = {key: value for group in groups.values() for key, value in group.items()}
    ratios = {(f.of, f.unit): f for f in FIGURES if f.kind == RATIO}
    doubtful = {key for key, figure in ratios.items() if is_beyond(figure, first[key])}
    again = [measure(name) for name, group in groups.items() if doubtful & group.keys()]
    table = "\n".join((*HEADER, *rows(first)))
    print(table)
    if arguments.write:
        PAGE.write_text(f"{INTRODUCTION}{table}\n", encoding="utf-8")
    if lines := list(failures([first, *again])):
        sys.exit("\n".join(lines))


if __name__ == "__main__":
    main()
