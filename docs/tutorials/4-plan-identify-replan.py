# %% [markdown]
# # 4. Plan, identify, replan
#
# The motion of the joints decides how well the target becomes known. This tutorial plans a motion
# for a target of which nothing is known. It identifies the target from the samples of this motion,
# and plans the next motion with what is now known. `diagrams/plan_identify_replan.py` does the same
# in a Diagram with a controller.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import cpid_drake as cpid
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.planner import Planner
from cpid_drake.simulation.trials import ideal_samples, make_case

scenario = cpid.load_scenario(cpid.shipped_scenario("free_flyer_payload"))
spacecraft, truth = scenario.spacecraft.make(), scenario.target_truth()
suite = cpid.load_sensors("coarse", unstated="exact")


def worst(found):
    """Return the largest σ in percent of the scale of its parameter; NaN if one is not known."""
    sigma = np.sqrt(np.diag(found.covariance))
    return 100 * (sigma / parameter_scale(found.parameters)).max()


def move(motion, seed):
    """Return the noisy samples of a motion. Only this function uses the true target."""
    case = make_case(scenario, spacecraft, truth, suite, seed)
    case = replace(case, motion=motion, duration=motion.duration)
    return add_noise(suite, ideal_samples(case, spacecraft.tree, spacecraft.joint_names), seed)


# %% [markdown]
# ## A motion for an unknown target
#
# The planner draws plausible targets from the size of the spacecraft. The least favourable one
# counts. The plan keeps the limits of the joints, and the bodies at a distance. More candidates,
# iterations and targets give a better plan; here they are few, so that the search takes seconds.
#
# A half cosine of all joints, for comparison, does not even determine all ten parameters.

# %%
options = PlanOptions(candidates=200, iterations=15, targets=2)
planner = Planner(scenario, suite, options)
first = planner.run().motion

slow = cpid.HalfCosine(first.evaluate(0.0)[0], first.evaluate(0.0)[0] + 0.5, 10.0)
logs = {"half cosine": move(slow, 1), "first": move(first, 1)}
results = {
    name: cpid.identify(spacecraft, log, sensors=suite, momentum="zero")
    for name, log in logs.items()
}
for name, found in results.items():  # σ is nan if not all ten parameters are known
    print(f"{name:12} largest σ {worst(found):7.3f} % of scale, checks passed: {found.passed}")
print(results["first"])

assert not results["half cosine"].is_complete
assert results["first"].is_complete

# %% [markdown]
# ## The next motion
#
# What is known is now a prior. The planner looks for the motion that improves the worst parameter
# most. Both logs together give the estimate; each has its own start and its own biases.

# %%
known = results["first"]
prior = cpid.TargetPrior("first", known.parameters, known.covariance, known.combinations)
second = Planner(scenario, suite, replace(options, targets=1), prior).run().motion

logs["second"] = move(second, 2)
together = cpid.identify(
    spacecraft,
    {name: logs[name] for name in ("first", "second")},
    sensors=suite,
    momentum="zero",
)
print(f"after two motions: largest σ {worst(together):.3f} % of scale")
error = np.abs(together.parameters - truth.to_vector())
print("errors in σ:", (error / np.sqrt(np.diag(together.covariance))).round(1))

assert together.passed
assert worst(together) < worst(known)
assert (error < 4 * np.sqrt(np.diag(together.covariance))).all()

# %%
figure, axes = plt.subplots(1, 3, figsize=(9, 3), sharey=True, layout="constrained")
for axis, (title, motion) in zip(
    axes, {"half cosine": slow, "first plan": first, "second plan": second}.items()
):
    times = np.linspace(0, motion.duration, 200)
    axis.plot(times, [motion.evaluate(t)[0] for t in times])
    axis.set(title=title, xlabel="time [s]")
axes[0].set_ylabel("joints [rad]")
plt.show()

# %%
figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
shown = {**results, "first and second": together}
for k, (name, found) in enumerate(shown.items()):
    sigma = np.sqrt(np.diag(found.covariance)) / parameter_scale(found.parameters)
    axis.semilogy(cpid.PARAMETER_NAMES, 100 * sigma, "osd"[k], label=name)
axis.set(ylabel="σ [% of scale]")
axis.legend(fontsize="small")
plt.show()
