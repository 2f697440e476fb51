#!/usr/bin/env python3
"""The paper's case as a Drake Diagram: simulate, identify online, compare with the truth.

Everything comes from a scenario file; `make_simulation` turns it into one Diagram.
"""

import argparse
from pathlib import Path

import numpy as np

from cpid_drake import (
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    InputError,
    load_scenario,
    make_simulation,
    shipped_scenario,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default=shipped_scenario("paper"), help="scenario YAML file")
    parser.add_argument("--graph", metavar="FILE", help="write the Diagram as Graphviz source")
    args = parser.parse_args()
    try:
        simulation = make_simulation(load_scenario(args.scenario))
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    if args.graph:
        try:
            Path(args.graph).write_text(simulation.diagram.GetGraphvizString(), encoding="utf-8")
        except OSError as error:
            parser.exit(2, f"{parser.prog}: error: --graph {args.graph}: {error.strerror}\n")

    root_context = simulation.run()

    identifier = simulation.identifier
    result = identifier.identification(identifier.GetMyContextFromRoot(root_context))
    print(result.explain())
    deviation = np.sqrt(np.diag(result.covariance))
    truth = simulation.truth.to_vector()
    print(f"{'':12}{'estimate':>18}{'std. deviation':>18}{'truth':>12}")
    for row in zip(PARAMETER_NAMES, PARAMETER_UNITS, result.parameters, deviation, truth):
        name, unit, estimate, sigma, true = row
        print(f"{f'{name} [{unit}]':12}{estimate:18.10f}{sigma:18.1e}{true:12.7g}")


if __name__ == "__main__":
    main()
