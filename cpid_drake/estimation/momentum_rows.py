"""Momentum rows of samples, and the errors that the errors of the samples make in them."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.momentum import MomentumSamples, momentum_samples
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.plane import in_plane
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree


def momentum_rows(
    tree: KinematicTree, telemetry: Motion, family: RowFamily, momentum: TotalMomentum
) -> Array:
    """Return the rows [N | A | b] (samples · rows per sample, k + 11) of all samples, in C.

    N holds the k columns of an unknown momentum; see `momentum_columns`. A known momentum enters b:
    in a frame that moves with the centre of mass the linear momentum is zero, so the angular rows
    of a sample (its last three rows) give the angular momentum about any point.

    If a table carries the base, the rows are those of the plane; see `RowFamily.rows_in_plane`.
    """
    if tree.normal_B is not None:
        telemetry = in_plane(telemetry, tree.normal_B)
    if not momentum.is_unknown and momentum.v_WScm_W.any():
        telemetry = replace(telemetry, v_WB=telemetry.v_WB - momentum.v_WScm_W)
    return rows_of_samples(tree, momentum_samples(tree, telemetry), family, momentum)


def rows_of_samples(
    tree: KinematicTree, samples: MomentumSamples, family: RowFamily, momentum: TotalMomentum
) -> Array:
    """Return the rows of `momentum_rows` from samples in the frame that it describes."""
    rows = family.full_rows(samples, momentum.is_unknown)
    if not momentum.is_unknown and momentum.L_WScm_W.any():
        # A θ = b + R_CW L
        by_sample = rows.reshape(len(samples), family.rows_per_sample, -1)
        R_CW = np.swapaxes(samples.motion.R_WC, -1, -2)
        by_sample[:, -3:, -1] += rotate(R_CW, momentum.L_WScm_W)
    if tree.normal_B is not None:
        return family.rows_in_plane(rows, samples.motion.R_WC, tree.unknowns)
    return rows


def momentum_columns(tree: KinematicTree, family: RowFamily, momentum: TotalMomentum) -> int:
    """Return the number of columns that a momentum adds to the rows of a family."""
    if not momentum.is_unknown:
        return 0
    return family.momentum_size if tree.normal_B is None else len(family.momenta_in_plane())


def changed_motion(telemetry: Motion, changes: Array) -> Motion:
    """Return motion with changed quantities, at unconnected times 0, 1, 2, ….

    Args:
        telemetry: the motion at N instants.
        changes: (M N, 12 + 2J) changes of the attitude (a rotation in B), of the angular velocity
            in B, of p_WB and v_WB, and of q and q̇; for M times the motion.

    """
    J, count = len(telemetry.joint_names), len(changes) // len(telemetry)

    def tiled(values: Array) -> Array:
        return np.tile(values, (count, 1))

    attitude = Rotation.from_quat(tiled(telemetry.quaternion_WB), scalar_first=True)
    w_B = attitude.inv().apply(tiled(telemetry.w_WB)) + changes[:, 3:6]
    # R exp(ξ), with ξ in B
    attitude = attitude * Rotation.from_rotvec(changes[:, :3])
    return Motion(
        telemetry.joint_names,
        np.arange(len(changes), dtype=float),
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=tiled(telemetry.p_WB) + changes[:, 6:9],
        w_WB=attitude.apply(w_B),
        v_WB=tiled(telemetry.v_WB) + changes[:, 9:12],
        q=tiled(telemetry.q) + changes[:, 12 : 12 + J],
        qdot=tiled(telemetry.qdot) + changes[:, 12 + J :],
    )


def error_square(
    telemetry: Motion,
    covariance: Array,
    tree: KinematicTree,
    family: RowFamily,
    momentum: TotalMomentum,
) -> Array:
    """Return the expectation (k + 11, k + 11) of δᵀ δ for the errors δ of all rows of samples.

    Args:
        telemetry: N samples.
        covariance: (N or 1, q, q) of their errors as changes of the q quantities of
            `changed_motion`.
        tree, family, momentum: see `momentum_rows`.

    """
    step, N, q = 1e-6, len(telemetry), covariance.shape[-1]
    rows = momentum_rows(tree, telemetry, family, momentum)
    moved = changed_motion(telemetry, np.repeat(step * np.eye(q), N, axis=0))
    # E[δᵀ δ] = Σ over samples and rows of Dᵀ C D, with the derivatives D of a row by changes
    by = (momentum_rows(tree, moved, family, momentum).reshape(q, *rows.shape) - rows) / step
    flat = np.moveaxis(by.reshape(q, N, -1), 0, 1)
    return np.asarray(
        flat.reshape(-1, rows.shape[1]).T @ (covariance @ flat).reshape(-1, rows.shape[1])
    )
