"""A small neural network that reads the target's parameters from the gyro of one joint motion.

Training is done before the flight, for one spacecraft, one motion and one kind of targets: the
responses follow from conservation of momentum, without integration. Inputs are the gyro's means
over a tenth of a second, minus their mean over all targets, projected on the directions in which
they vary by more than the noise. Outputs are log m, c and I/m. Every batch gets fresh noise.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake import JointMotion, Spacecraft
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.parameterizations import (
    STANDARD,
    moved_moments,
    standard_to_relative,
    tensor_to_vector,
)
from cpid_drake.sensors.sensors import Gyro

Array = NDArray[np.float64]

BIN = 0.1
"""Time over which the gyro is averaged [s]."""

TARGETS, UNITS, BATCH = 20_000, 96, 256
"""Training targets, units in each of two hidden layers, and targets in a batch. Five times the
targets and twice the units gain a factor of 1.5 for three times the time."""

STEPS = 40_000
"""Batches of a training: less than a minute on one quiet processor."""

LEARNING_RATE = 3e-3
"""Of Adam (Kingma and Ba 2015) at the start; it falls to zero as a cosine."""

MASSES, DISTANCE, SIDES = (20.0, 300.0), 0.8, (0.3, 2.0)
"""Training targets: masses [kg], log-uniform; largest distance of the centre of mass [m]; sides of
boxes [m]."""


@dataclass(frozen=True, eq=False)
class Network:
    """A trained network: projection and layers of its input, offset and scale of its output."""

    mean: Array
    project: Array
    layers: tuple[tuple[Array, Array], ...]
    centre: Array
    scale: Array

    def parameters(self, w: Array) -> Array:
        """Return the parameters (M, 10) of M flights' means (M, n), see `responses`."""
        x = (w - self.mean) @ self.project
        return _parameters(_forward(self.layers, x)[-1] * self.scale + self.centre)


def training_targets(count: int, rng: np.random.Generator) -> Array:
    """Return standard vectors (count, 10) of boxes, turned at random."""
    mass = np.exp(rng.uniform(np.log(MASSES[0]), np.log(MASSES[1]), count))
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    com = DISTANCE * rng.uniform(size=(count, 1)) ** (1 / 3) * direction
    squares = rng.uniform(SIDES[0], SIDES[1], (count, 3)) ** 2
    moments = mass[:, None] / 12 * (squares.sum(axis=1, keepdims=True) - squares)
    R = Rotation.random(count, rng).as_matrix()
    central = R @ (moments[:, :, None] * np.swapaxes(R, 1, 2))
    h, J = moved_moments(mass, central, np.eye(3), com)
    return np.concatenate([mass[:, None], h, tensor_to_vector(J)], axis=1)


def responses(
    spacecraft: Spacecraft, motion: JointMotion, phi: Array, duration: float, shift: float = 0.0
) -> Array:
    """Return the gyro's means (M, n) for M targets at zero momentum, without integration.

    A mean is the middle's value, plus a 24th of the second difference. All joints are shifted by
    `shift` [rad or m].
    """
    times = (np.arange(round(duration / BIN)) + 0.5) * BIN
    q, qdot, _ = np.moveaxis(motion.evaluate(times), 1, 0)
    known = BodyDynamics.at(spacecraft.tree.lumped, q + shift, qdot)
    psi = standard_to_relative(phi, spacecraft.mass)
    parts = []
    for some in np.array_split(psi, max(len(psi) // 500, 1)):  # to bound the memory
        h = known.momentum_at_rest(some)[..., None]
        w = -np.linalg.solve(known.inertia(some), h)[..., 0]
        bend = np.pad(np.diff(w, 2, axis=1), ((0, 0), (1, 1), (0, 0)), mode="edge")
        parts.append((w + bend / 24).reshape(len(some), -1))
    return np.concatenate(parts)


def train(
    spacecraft: Spacecraft,
    motion: JointMotion,
    gyro: Gyro,
    duration: float,
    *,
    targets: int = TARGETS,
    steps: int = STEPS,
    seed: int = 1,
) -> Network:
    """Train a network.

    Args:
        spacecraft: the spacecraft model.
        motion: the motion of its joints.
        gyro: the errors of the gyro.
        duration: of the motion [s].
        targets, steps: numbers of training targets and of batches.
        seed: of targets, weights and noise.

    """
    rng = np.random.default_rng(seed)
    phi = training_targets(targets, rng)
    w, y = responses(spacecraft, motion, phi, duration), _outputs(phi)
    sigma, bias = gyro.sigma / np.sqrt(gyro.rate * BIN), gyro.bias_sigma
    mean, centre, scale = w.mean(axis=0), y.mean(axis=0), y.std(axis=0)
    _, s, Vt = np.linalg.svd(w - mean, full_matrices=False)
    kept = s / np.sqrt(len(w)) > np.hypot(sigma, bias)
    project = Vt[kept].T * np.sqrt(len(w)) / s[kept]
    x, y = (w - mean) @ project, (y - centre) / scale
    bias_root = bias * np.tile(np.eye(3), (w.shape[1] // 3, 1)).T @ project
    x, y, bias_root = (each.astype(np.float32) for each in (x, y, bias_root))
    sizes = (x.shape[1], UNITS, UNITS, 10)
    layers = [(rng.standard_normal((a, b)) / np.sqrt(a), np.zeros(b)) for a, b in pairwise(sizes)]
    flat = [each for layer in layers for each in layer]
    first, second = [np.zeros_like(each) for each in flat], [np.zeros_like(each) for each in flat]
    spread = (sigma * np.linalg.norm(project, axis=0)).astype(np.float32)
    for step in range(1, steps + 1):
        some = rng.integers(0, len(x), BATCH)
        noise = spread * rng.standard_normal((BATCH, x.shape[1]), np.float32)
        noisy = x[some] + noise + rng.standard_normal((BATCH, 3), np.float32) @ bias_root
        gradients = _gradients(tuple(zip(flat[::2], flat[1::2])), noisy, y[some])
        rate = np.float32(LEARNING_RATE * (1 + np.cos(np.pi * step / steps)) / 2)
        for k, gradient in enumerate(gradients):
            first[k] += np.float32(0.1) * (gradient - first[k])
            second[k] += np.float32(0.001) * (gradient**2 - second[k])
            size = np.sqrt(second[k] / np.float32(1 - 0.999**step)) + np.float32(1e-8)
            flat[k] -= rate * first[k] / np.float32(1 - 0.9**step) / size
    return Network(mean, project, tuple(zip(flat[::2], flat[1::2])), centre, scale)


def _outputs(phi: Array) -> Array:
    """Return log m, c and I/m (M, 10) of standard vectors."""
    found = STANDARD.to_parameters(phi)
    return np.concatenate(
        [np.log(found[:, :1]), found[:, 1:4], found[:, 4:] / found[:, :1]], axis=1
    )


def _parameters(outputs: Array) -> Array:
    mass = np.exp(outputs[:, :1])
    return np.concatenate([mass, outputs[:, 1:4], outputs[:, 4:] * mass], axis=1)


def _forward(layers: tuple[tuple[Array, Array], ...], x: Array) -> list[Array]:
    """Return the inputs of all layers, and the output."""
    values = [x]
    for k, (W, b) in enumerate(layers):
        z = values[-1] @ W + b
        values.append(np.tanh(z) if k < len(layers) - 1 else z)
    return values


def _gradients(layers: tuple[tuple[Array, Array], ...], x: Array, y: Array) -> list[Array]:
    """Return the gradients of the mean squared error, in the order of weights and offsets."""
    values, gradients = _forward(layers, x), list[Array]()
    slope = (values[-1] - y) / y.size
    for k in range(len(layers) - 1, -1, -1):
        gradients = [values[k].T @ slope, slope.sum(axis=0), *gradients]
        if k:
            slope = slope @ layers[k][0].T * (1 - values[k] ** 2)
    return gradients
