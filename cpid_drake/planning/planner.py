"""Plans the joint motion of a scenario that determines the target best."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.search import Candidate, candidates, ranked, refined
from cpid_drake.processes import one_thread
from cpid_drake.scenario.limits import check_limits
from cpid_drake.scenario.simulation import make_simulation

TIGHTENINGS = 3
"""Largest number of times that limits are lowered, or demanding targets are added."""

SEEN_CANDIDATES = 4
"""Number of the best candidates that show which joints and targets need much."""

SPARE_STARTS = 4
"""Number of further candidates, one of which is used if no start leads to a plan."""

START_SHARES = (1.0, 0.5, 0.2)
"""Shares of candidates' parameters that are tried as starts if the base's motion is limited."""

START_EXCESS = 1.5
"""Largest share of a limit of the base's motion that such a start may reach."""

LESS_MOTION = (0.97, 0.94, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Shares of the parameters of a motion that moves the base too much, which are tried in turn."""

FIRST_TARGETS = 3
"""Number of targets for which the gradient method improves candidates before it does for all."""

FIRST_SHARE = 3
"""Number of times that the iterations for these targets are fewer."""

MOST_EXAMINED = 300
"""Largest number of candidates, the best first, in which constraints are evaluated."""


@dataclass(eq=False)
class Planner:
    """Plans one motion.

    Args:
        problem: the motion's family, targets and constraints.
        best: the best motion so far that keeps all constraints, also after an interrupt.

    """

    problem: PlanProblem
    best: Candidate | None = None
    _seen: list[Candidate] = field(default_factory=list)

    @one_thread
    def run(self, progress: Callable[[str, float], None] = lambda what, best: None) -> Candidate:
        """Search; return the best motion that keeps all constraints.

        Args:
            progress: called with the present step in words and the best criterion so far.

        Raises:
            InputError: none of the candidates keeps the constraints.

        """
        options, limited, start = self.problem.options, self.problem.limited, time.perf_counter()

        def scored(done: int, best: float) -> None:
            progress(f"{done} of {options.candidates} candidates", best)

        drawn = candidates(limited, options.candidates, options.seed)
        objective = self.problem.objective
        order = ranked(objective, drawn, options.jobs, scored)
        seen = np.stack([each.parameters for each in order[:SEEN_CANDIDATES]])
        self.problem.demands.begin(seen)
        starts = self._kept(order, options.starts)
        for each in starts:
            self._see(each)

        def better(candidate: Candidate) -> None:
            self._see(candidate)
            what = f"gradient method, {time.perf_counter() - start:.0f} s"
            if self.best is None:
                progress(f"{what}, not within all limits yet", candidate.score)
            else:
                progress(what, self.best.score)

        chosen = starts
        if starts and len(objective.targets) > FIRST_TARGETS:
            what = f"gradient method for {FIRST_TARGETS} targets"
            chosen = [self._prepared(starts, lambda one: progress(what, one.score))]
        for each in chosen:
            self._improve(each, better)
        if self.best is None:  # the gradient method met a dead end
            for each in self._kept(order, options.starts + SPARE_STARTS)[options.starts :]:
                self._improve(each, better)
                if self.best is not None:
                    break
        if self.best is None:
            raise InputError(
                "no motion keeps the constraints; allow smaller distances or more motion of the "
                "base, a longer duration, or give more --candidates"
            )
        return self.best

    def _see(self, candidate: Candidate) -> None:
        """Keep a motion if it is the best so far, and keeps all constraints.

        Targets with which it exceeds a limit are checked from now on.
        """
        if candidate.score >= (np.inf if self.best is None else self.best.score):
            return
        self._demand_more(candidate.parameters)
        if self.problem.is_kept(candidate):
            self.best = candidate
            self._seen.append(candidate)

    def _demand_more(self, parameters: NDArray[np.float64]) -> bool:
        """Add the targets that a motion demands, and choose again; return whether there are any."""
        if not self.problem.demands.demand_more(parameters):
            return False
        self._seen = [each for each in self._seen if self.problem.is_kept(each)]
        self.best = min(self._seen, key=lambda one: one.score, default=None)
        return True

    def _prepared(self, starts: list[Candidate], better: Callable[[Candidate], None]) -> Candidate:
        """Return the best for all targets of the motions that are found for a few targets.

        It need not keep the constraints that depend on the target. They are imposed from now on for
        those targets with which it exceeds a limit.
        """
        problem, objective = self.problem, self.problem.objective
        few = replace(objective, targets=objective.targets[:FIRST_TARGETS])
        iterations = max(problem.options.iterations // FIRST_SHARE, 1)
        found = [
            refined(few, problem.limited, problem.constraints, each, iterations, better)[0]
            for each in starts
        ]
        parameters = np.array([each.parameters for each in found])
        best = parameters[objective.scores(parameters).argmin()]
        self._demand_more(best)
        return Candidate(best, np.inf)

    def _improve(self, start: Candidate, better: Callable[[Candidate], None]) -> None:
        """Improve a motion by the gradient method, and see all motions on the way; see `run`."""
        problem = self.problem
        first, iterations = start, problem.options.iterations
        for _ in range(1 + TIGHTENINGS):
            found = refined(
                problem.objective,
                problem.limited,
                problem.constraints,
                first,
                iterations,
                better,
            )
            is_enough = not self._demand_more(found[0].parameters)
            needed = problem.needed(found[0])
            if needed.largest <= 1 and is_enough:
                break
            problem.demands.tighten(found[0].parameters, needed)
            first, iterations = Candidate(found[0].parameters, np.inf), iterations // 2
        if problem.demands.base_limits:
            for each in self._moving_less(found[0].parameters):
                self._see(each)

    def _moving_less(self, parameters: NDArray[np.float64]) -> Iterator[Candidate]:
        """Yield motions that move the joints less than one that moves the base too much."""
        for share in LESS_MOTION:
            scaled = share * parameters
            yield Candidate(scaled, float(self.problem.objective.scores(scaled[None])[0]))

    def _kept(self, order: list[Candidate], count: int) -> list[Candidate]:
        """Return the first candidates that keep the distances and the limits of the base's motion.

        If all candidates move the base too much, motions that move the joints less are returned,
        and at last those that move the base a little too much: the gradient method changes them.
        The score is infinite if the base moves too much or efforts are too large.
        """
        problem = self.problem
        base, found = problem.demands.base_limits, list[Candidate]()
        tried = [*((share, 1.0) for share in START_SHARES), (START_SHARES[-1], START_EXCESS)]
        for share, largest in tried if base else [(1.0, 1.0)]:
            for each in order[:MOST_EXAMINED]:
                x = share * each.parameters
                if any(limit.demands(x[None]).max() > largest for limit in base):
                    continue
                if all(one.values(x).min() >= 0 for one in problem.geometric):
                    start = Candidate(x, each.score if share == 1 else np.inf)
                    found.append(start if problem.is_kept(start) else replace(start, score=np.inf))
                if len(found) == count:
                    return found
        return found

    def own_needs(self) -> float:
        """Return the share of the limits that the scenario's motion needs, over checked targets."""
        problem = self.problem
        return problem.demands.needed(problem.own_motion, problem.checked_targets).largest

    def active(self, candidate: Candidate) -> list[str]:
        """Return the limits that a motion uses to more than 97 %, in words."""
        problem = self.problem
        found, names = [], problem.family.joint_names
        usage = problem.limited.usage(candidate.parameters)
        for row, what in zip(usage, ("position", "rate", "acceleration"), strict=True):
            at = [names[problem.family.moving[k]] for k in np.flatnonzero(row > 0.97)]
            if at:
                found.append(f"{what} of {', '.join(at)}")
        for each in problem.constraints:
            if each.values(candidate.parameters).min() < 0.03:
                found.append(each.name)
        return found

    def exceeded(self, candidate: Candidate) -> list[str]:
        """Return the limits that a motion exceeds in Drake's plant, for all checked targets."""
        problem = self.problem
        simulated = replace(problem.scenario.simulation, duration=problem.family.duration)
        declared = problem.family.declare(candidate.parameters)
        scenario = replace(problem.scenario, joint_motion=declared, simulation=simulated)
        found: dict[str, None] = {}
        for target in problem.checked_targets:
            body = InertialParameters.from_vector(target)
            found |= dict.fromkeys(check_limits(make_simulation(scenario, target=body)).exceeded)
        return list(found)
