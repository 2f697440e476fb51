"""A platform without joints on an air-bearing floor, which eight on/off valves push."""

from pathlib import Path

import numpy as np
from worlds.hardware import Body, Craft, Valve, run
from worlds.hardware_draws import Draw, inside, pose_sensors, samples, write

MASS, RATE, DURATION = 23.0, 16.0, 60.0
"""Of platform and target [kg], of motion capture [Hz], and of the log [s]."""

OWN, COMMON, DELAY = 0.1, 0.05, 0.1
"""σ of the errors of the valves' forces, of each and of all in common; delay of the thrust [s]."""


def platform(seed: int, folder: Path, *, common: bool = True) -> tuple[Draw, float]:
    """Return a draw, and the true error that all forces have in common; one valve is dead."""
    rng = np.random.default_rng([12, 4, seed])
    base = Body.drawn(rng, 0.55 * MASS, 0.35, 0.02 * rng.standard_normal(3))
    target = Body.drawn(rng, 0.45 * MASS, 0.3, [0.12, *0.04 * rng.standard_normal(2)])
    craft = Craft(base, target, capture=np.array([0.2, 0.0, 0.0]), planar=True)
    shared = COMMON * rng.standard_normal()
    valves = [
        Valve(
            np.array([0.2 * x, 0.2 * y, 0.0]),
            -np.array(along, dtype=float),
            0.5,
            (1 + shared) * (1 + OWN * rng.standard_normal()),
        )
        for x in (-1, 1)
        for y in (-1, 1)
        for along in ([x, 0, 0], [0, y, 0])
    ]
    dead = int(rng.integers(len(valves)))
    valves[dead].share = 0.0
    times, floor = np.arange(int(DURATION * RATE)) / RATE, (1e-3, 1e-3 * MASS * 0.2)

    def rest(t):
        return np.zeros((len(t), 0)), np.zeros((len(t), 0))

    command = inside(rng, valves, RATE, MASS)
    found = run(craft, times, rest, rng, valves=valves, delay=DELAY, floor=floor, command=command)
    columns = samples(rng, craft, times, found, rest(times)[0], 1e-3, 2e-3, 0.0, [])
    names = [f"v{k + 1}" for k in range(len(valves))]
    columns |= {f"valve:{name}": u for name, u in zip(names, found["opening"].T)}
    thrusters = {"delay_ms": 100.0} | ({"common_force": COMMON} if common else {})
    thrusters["valves"] = {
        name: {
            "position": valve.position.tolist(),
            "direction": valve.direction.tolist(),
            "force": valve.force,
            "force_sigma": OWN * valve.force,
        }
        for name, valve in zip(names, valves)
    }
    a, t = map(float, floor)
    sensors = pose_sensors(RATE, 1e-3, 2e-3) | {"thrusters": thrusters}
    sensors["disturbances"] = {"acceleration_noise": a, "torque_noise": t}
    return write(folder, craft, sensors, [columns], names[dead]), shared
