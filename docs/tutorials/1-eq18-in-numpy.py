# %% [markdown]
# # 1. Eq. 18 in plain NumPy
#
# A spacecraft has caught a target and moves its arm. The motion of the base then determines ten
# numbers: the target's mass, its centre of mass and its inertia. This tutorial computes them in
# about a hundred lines, from the momentum of the bodies to the ten numbers. It uses NumPy only.
#
# W is the inertial frame, B the base, and C the capture frame on the last link. The target is held
# rigidly, so C is its body frame too.

# %%
import matplotlib.pyplot as plt
import numpy as np


def skew(a):
    """Return [a]× with [a]× b = a × b."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def sharp(w):
    """Return [#w] with [#w] (Ixx, Ixy, Ixz, Iyy, Iyz, Izz) = I w."""
    x, y, z = w
    return np.array([[x, y, z, 0, 0, 0], [0, x, 0, y, z, 0], [0, 0, x, 0, y, z]])


def rotation(axis, angle):
    """Return the rotation about a unit axis (Rodrigues' formula)."""
    a = skew(axis)
    return np.eye(3) + np.sin(angle) * a + (1 - np.cos(angle)) * a @ a


# %% [markdown]
# ## The spacecraft and the target
#
# Each body has a mass, a centre of mass in its own frame, and an inertia about it. The base of 200
# kg has an arm with three joints. The target is the last body. Only the simulation knows it.

# %%
base = (200.0, np.zeros(3), np.diag([30.0, 25.0, 35.0]))
link = (12.0, np.array([0.4, 0, 0]), np.diag([0.1, 0.8, 0.8]))
target = (50.0, np.array([0.3, 0.1, -0.05]), np.diag([4.0, 6.0, 5.0]))
bodies = [base, link, link, link, target]  # the joints move bodies 1 to 3; 4 is welded to 3
axes = np.eye(3)[[2, 1, 0]]  # of the joints, in the frame of the body before
places = np.array([[0.6, 0, 0], [0.8, 0, 0], [0.8, 0, 0], [0.8, 0, 0]])  # of the next frame


def states(R_WB, p_WB, w, v, q, qd):
    """Return (R, w, p, v) of each body's frame: attitude, angular velocity, origin, its velocity.

    Ning et al. 2016, Eqs. 1 to 3.
    """
    found = [(R_WB, w, p_WB, v)]
    for j, place in enumerate(places):
        R, w, p, v = found[-1]
        offset = R @ place
        p, v = p + offset, v + np.cross(w, offset)
        if j < len(axes):  # a joint; the target has none
            w = w + R @ axes[j] * qd[j]
            R = R @ rotation(axes[j], q[j])
        found.append((R, w, p, v))
    return found


def momentum(found, count, about):
    """Return (P, L) of the first bodies, L about a point.

    Eqs. 4 and 10; both sums begin with the base.
    """
    P, L = np.zeros(3), np.zeros(3)
    for (m, c, inertia), (R, w, p, v) in zip(bodies[:count], found):
        r, rate = p + R @ c, v + np.cross(w, R @ c)
        P += m * rate
        L += R @ inertia @ R.T @ w + np.cross(r - about, m * rate)
    return P, L


# %% [markdown]
# ## The motion
#
# The thrusters are off, and all was at rest, so the total momentum is zero. It is linear in the
# twist of the base. Six equations give this twist, and its integral is the motion of the base.


# %%
def joints(t):
    """Return positions and rates of the joints: sums of sines, at rest at the start."""
    rate = 2 * np.pi * np.array([0.11, 0.17, 0.23])
    return 0.6 * (1 - np.cos(rate * t)), 0.6 * rate * np.sin(rate * t)


def base_twist(R, p, q, qd):
    """Return (w, v) of the base for which the total momentum is zero."""

    def total(twist, rates):
        return np.hstack(momentum(states(R, p, twist[:3], twist[3:], q, rates), 5, np.zeros(3)))

    A = np.column_stack([total(unit, np.zeros(3)) for unit in np.eye(6)])
    twist = np.linalg.solve(A, -total(np.zeros(6), qd))
    return twist[:3], twist[3:]


step, samples = 0.02, []
R, p = np.eye(3), np.zeros(3)
for k in range(501):
    q, qd = joints(k * step)
    w, v = base_twist(R, p, q, qd)
    samples.append((R, p, w, v, q, qd))
    middle = rotation(w / (np.linalg.norm(w) + 1e-300), np.linalg.norm(w) * step / 2) @ R
    w, v = base_twist(middle, p + v * step / 2, *joints((k + 0.5) * step))  # the midpoint rule
    R = rotation(w / np.linalg.norm(w), np.linalg.norm(w) * step) @ R
    p = p + v * step

times = step * np.arange(501)
figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
axis.plot(times, np.degrees([each[2] for each in samples]), label=["x", "y", "z"])
axis.set(xlabel="time [s]", ylabel="angular velocity of the base [deg/s]")
axis.legend()
plt.show()

# %% [markdown]
# ## The rows of Eq. 18
#
# P and L are the momentum of the *known* bodies: all but the target. The target has the opposite
# momentum. With all vectors in C, and L about the origin of C, its ten numbers obey two laws:
#
# $$\frac{P}{m} + \omega \times c = -v, \qquad P \times c + I \omega = -L$$
#
# They are linear in $\theta = (1/m, c, I)$. This is Eq. 18, six rows for each sample:
#
# $$\begin{bmatrix} P & [\omega]_\times & 0 \\ 0 & [P]_\times & [\#\omega] \end{bmatrix} \theta
# = -\begin{bmatrix} v \\ L \end{bmatrix}$$


# %%
def rows(sample):
    """Return A (6, 10) and b (6,) of one sample."""
    R_WB, p_WB, w, v, q, qd = sample
    found = states(R_WB, p_WB, w, v, q, qd)
    R, w, p, v = found[4]  # of C
    P, L = momentum(found, 4, about=p)
    P, L, w, v = R.T @ P, R.T @ L, R.T @ w, R.T @ v  # from W to C
    A = np.zeros((6, 10))
    A[:3, 0], A[:3, 1:4] = P, skew(w)
    A[3:, 1:4], A[3:, 4:] = skew(P), sharp(w)
    return A, -np.hstack([v, L])


def identify(chosen):
    """Return the ten numbers (m, c, Ixx, Ixy, Ixz, Iyy, Iyz, Izz) and the rank of the rows."""
    A, b = (np.concatenate(parts) for parts in zip(*map(rows, chosen)))
    theta, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-10)
    return np.hstack([1 / theta[0], theta[1:]]), rank


truth = np.hstack([target[0], target[1], target[2][np.triu_indices(3)]])
estimate, rank = identify(samples[50::50])
names = ["m", "cx", "cy", "cz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"]
for name, true, value in zip(names, truth, estimate):
    print(f"{name:4}{true:10.4f}{value:20.12f}")

assert rank == 10
assert np.abs(estimate - truth).max() < 1e-9

# %% [markdown]
# ## How many samples?
#
# One sample has rank 6. Two have rank 9: one combination is not identifiable. Three determine all
# ten numbers. The angular velocities must differ in direction: a motion about one axis has rank 7.

# %%
for count in (1, 2, 3, 10):
    print(count, "samples: rank", identify(samples[50 : 50 + 40 * count : 40])[1])

assert [identify(samples[50 : 50 + 40 * n : 40])[1] for n in (1, 2, 3)] == [6, 9, 10]

# %% [markdown]
# ## What rounding does
#
# Sensors are not exact. Here each sample is rounded to a number of decimals. Each further decimal
# makes the error ten times smaller. In Eq. 18 the measured momentum is in the matrix, so rounding
# also causes a bias. [The next tutorial](2-in-a-diagram) uses an estimator that knows the noise.

# %%
decimals = np.arange(4, 11)
errors = []
for number in decimals:
    rounded = [tuple(np.round(part, number) for part in each) for each in samples[50::50]]
    errors.append(abs(identify(rounded)[0][0] / truth[0] - 1))

figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
axis.semilogy(decimals, errors, "o-")
axis.set(xlabel="decimals of the samples", ylabel="relative error of the mass")
plt.show()

assert errors[0] > 1e4 * errors[-1]
