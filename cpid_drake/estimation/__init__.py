"""Estimators in plain NumPy and SciPy, independent of Drake.

The path of a sample y, from a file to the interval of a parameter. `logs.conversion` reads it,
`identification.checked_log` screens it, and `identification.log_sensors` has its σ, given or
estimated. Then `identification.fitted.estimate` goes on:

 1. `block`: samples are cut into blocks of about a second; `log_state` holds their `BlockState`s.
 2. `joints`: a spline through the joints' samples, with their noise.
 3. `start`: values x of all unknowns (`unknowns`) with which the fit begins.
 4. `roll`: the residual r = (y − h(x))/σ in each block, and H = ∂(h/σ)/∂x, by a `likelihood.model`:
    `motion_model` has the base's ω for x, `sensor_models` the reading h, `effect_terms` δω by each
    unknown, and `motion_change` what follows from δω.
 5. `process`, `whitening`: C⁻¹ with which residual and derivatives have white noise of a unit.
 6. `block_rows`: rows C⁻¹ H δx = C⁻¹ r, with those of the joints.
 7. `elimination`, `sweep`: QR with the rows of the link to the next block leaves R δx = z of what
    outlives the block: a `gaussian`.
 8. `fit`: all logs' and the priors' Gaussians are added; `target` has the best δψ in its cone, and
    `sweep.back` the δx of all else. Again from 4, with `weights` and `noise` as r shows them.
 9. `events`, `evidence`: whether momentum is zero, and where it changes;
    `identification.chosen_fit` holds the momenta that are, and `fit.about` makes it linear there.
10. `posterior.target_estimate`: what the samples say of ψ, without the prior that `fit` has added.
11. `parameters`: π(ψ) and its σ, which `identification.result` takes; `identification.answer` adds
    checks, warnings and the budget. Intervals end where a rigid body does
    (`identification.consistency`).

`online` and `following` do this block after block, with a `past`. `rows_fit` is the short path of
exact samples: `momentum_rows` of a row family, then least squares.
"""
