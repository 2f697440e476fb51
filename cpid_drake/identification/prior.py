"""What is known about a target before a log: from its design, or from an earlier identification."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import (
    Parameterization,
    parameter_scale,
    relative_parameterization,
)
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.files.checked_yaml import load_yaml
from cpid_drake.files.constraints import Limits, Numbers
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import resolve_model
from cpid_drake.identification.result import Combinations, Identification
from cpid_drake.identification.result_files import read_result
from cpid_drake.spacecraft.spacecraft import Spacecraft

Positive = Annotated[float, Limits(gt=0, le=1e9)]


@dataclass(frozen=True, eq=False)
class TargetPrior:
    """A prior of the target.

    Attributes:
        name: its name in messages.
        parameters: (10,) π in the spacecraft's capture frame; NaN where not identifiable.
        covariance: (10, 10) of `parameters`; NaN where not identifiable.
        combinations: what an estimate determines in its own unknowns, which is used in place of
            the parameters where these are the unknowns; None without any.
        failures: reasons not to trust the prior.

    """

    name: str
    parameters: Array
    covariance: Array
    combinations: Combinations | None = None
    failures: tuple[str, ...] = ()

    def moved(self, form: Parameterization, at: Array) -> Array:
        """Return the unknowns `at` (10,) with the prior's values where the prior has any."""
        if self.combinations is not None and self.combinations.unknowns == form.name:
            return self.combinations.values
        is_known = np.isfinite(self.parameters)
        return form.from_parameters(np.where(is_known, self.parameters, form.to_parameters(at)))

    def of_psi(self, model: Model, psi: Array | None = None) -> Gaussian:
        """Return the prior of a model's target, linear about ψ (10,); by default about itself."""
        form = relative_parameterization(model.mass)
        psi = self.moved(form, model.unknown(PSI).mean) if psi is None else psi
        return self.gaussian(PSI, form, psi, model.plausible)

    def gaussian(self, name: str, form: Parameterization, at: Array, unit: Array) -> Gaussian:
        """Return the prior of the unknowns of a parameterization, linear about `at` (10,).

        Raises an InputError if it determines combinations of other unknowns. Combinations of sizes
        far below `unit` (10,), the plausible ones, are rounding.
        """
        own = self.combinations
        given = np.isfinite(self.parameters)
        if own is not None and own.unknowns != form.name and not given.all():
            raise InputError(
                f"{self.name} determines combinations of {own.unknowns} unknowns, and the "
                f"estimator has {form.name} unknowns: use the estimator of the prior"
            )
        if own is not None and own.unknowns == form.name:
            # Λ = V S Vᵀ in units of plausible sizes: rows √S Vᵀ x, with unit errors
            sizes, axes = np.linalg.eigh(own.information * unit * unit[:, None])
            is_significant = sizes > len(sizes) ** 2 * np.finfo(float).eps * max(
                float(sizes[-1]), 0.0
            )
            A = np.sqrt(sizes[is_significant])[:, None] * axes[:, is_significant].T / unit
            return Gaussian.of_rows({name: 10}, np.column_stack([A, A @ own.values]))
        covariance = self.covariance[np.ix_(given, given)]
        sigma = np.sqrt(np.diag(covariance))
        # W = C⁻½: W J x = W (π − π(x₀) + J x₀)
        root = np.linalg.cholesky(covariance / sigma / sigma[:, None])
        whiten = np.linalg.solve(root, np.diag(1 / sigma))
        jacobian = form.jacobian(at)[given]
        change = self.parameters[given] - form.to_parameters(at)[given]
        rows = whiten @ np.column_stack([jacobian, change + jacobian @ at])
        return Gaussian.of_rows({name: 10}, rows)


@dataclass
class PriorConfig:
    """A target as its design says, with σ [kg, m, kg·m²]; null for what is not known.

    `p_CTcm_C` and `I_TTcm_C` are in the capture frame. `sigma` is relative to the mass for the
    mass, to the radius of gyration for the centre of mass, and to the trace of the inertia for the
    inertia; `sigma_mass`, `sigma_p_CTcm_C` and `sigma_I_TTcm_C` replace it for one of them.
    """

    mass: Positive | None = None
    p_CTcm_C: Annotated[Array, Numbers(3)] | None = None
    I_TTcm_C: Annotated[Array, Numbers(3, 3)] | None = None
    sigma: Annotated[float, Limits(ge=1e-6, le=100)] | None = None
    sigma_mass: Positive | None = None
    sigma_p_CTcm_C: Positive | None = None
    sigma_I_TTcm_C: Positive | None = None

    def __post_init__(self) -> None:
        self.prior("")

    def prior(self, name: str) -> TargetPrior:
        """Return the prior, with its name in messages.

        Raises:
            InputError: it contains nothing, no rigid body has the values, or a σ is missing.

        """
        parts = {"mass": slice(0, 1), "p_CTcm_C": slice(1, 4), "I_TTcm_C": slice(4, 10)}
        parts = {key: part for key, part in parts.items() if getattr(self, key) is not None}
        if not parts:
            raise InputError("give mass, p_CTcm_C or I_TTcm_C")
        mass = 1.0 if self.mass is None else self.mass
        place = np.zeros(3) if self.p_CTcm_C is None else self.p_CTcm_C
        inertia = np.eye(3) if self.I_TTcm_C is None else self.I_TTcm_C
        body = InertialParameters(mass, place, inertia)
        problems = body.inconsistencies()
        if problems:
            raise InputError(f"not a rigid body: {'; '.join(problems)}")
        values = body.to_vector()
        scale = parameter_scale(values) if np.trace(inertia) > 0 else np.zeros(10)
        parameters, sigma = np.full(10, np.nan), np.full(10, np.nan)
        for key, part in parts.items():
            own = getattr(self, f"sigma_{key}")
            if own is None and self.sigma is None:
                raise InputError(f"give sigma_{key}, or sigma for all")
            needs_size = own is None and key != "mass"
            if needs_size and (self.mass is None or self.I_TTcm_C is None):
                raise InputError(f"give sigma_{key}: sigma needs mass and I_TTcm_C")
            parameters[part] = values[part]
            sigma[part] = scale[part] * (self.sigma or 0.0) if own is None else own
            if not np.all(sigma[part] > 0):
                raise InputError(f"give sigma_{key}: the body has no size")
        covariance = np.full((10, 10), np.nan)
        entries = np.flatnonzero(np.isfinite(parameters))
        covariance[np.ix_(entries, entries)] = np.diag(sigma[entries] ** 2)
        return TargetPrior(name, parameters, covariance)


def load_prior(path: str | Path, spacecraft: Spacecraft, capture_frame: str) -> TargetPrior:
    """Return the prior in a file.

    Args:
        path: a result of `cpid identify` (JSON), or YAML with the keys of `PriorConfig`.
        spacecraft: the spacecraft model.
        capture_frame: its capture frame, in which the prior must be expressed.

    Raises:
        InputError: the file cannot be read; see `PriorConfig.prior`; the result is that of another
            capture frame, or of another spacecraft if it determines combinations only.

    """
    file, where = resolve_model(path), str(path)
    if file.suffix.lower() == ".json":
        return prior_of_result(read_result(file), where, spacecraft.mass, capture_frame)
    return load_yaml(PriorConfig, file, where, "a prior").prior(f"the prior {file.name}")


def prior_of_result(
    result: Identification, where: str, known_mass: float, capture_frame: str | None
) -> TargetPrior:
    """Return the prior that a result, in the file `where`, is for its target; see `load_prior`.

    It is for a spacecraft of a mass [kg]. Without a capture frame, that of the result is not
    compared.
    """
    if capture_frame is not None and result.spacecraft is None:
        raise InputError(
            f"{where}: the result names no spacecraft, so its capture frame is not known: give the "
            "Identification itself, or a file of `cpid identify --json` or `identify_files`"
        )
    frame = result.spacecraft.capture_frame if result.spacecraft else None
    if capture_frame is not None and frame != capture_frame:
        raise InputError(
            f"{where}: the prior is in the capture frame {frame}, the log's capture frame is "
            f"{capture_frame}: identify with the same frame"
        )
    own = result.combinations
    given = np.isfinite(np.diag(result.covariance))
    if own is not None and not np.isclose(own.known_mass, known_mass, rtol=1e-6):
        if not given.all():
            raise InputError(
                f"{where}: the result determines combinations of parameters for a spacecraft of "
                f"{own.known_mass:.6g} kg; this one has {known_mass:.6g} kg"
            )
        own = None
    if own is None and not given.any():
        raise InputError(f"{where}: the result determines no parameter")
    if own is not None and own.unknowns == "relative":
        stated = relative_parameterization(own.known_mass).to_parameters(own.values)
        sigma = np.sqrt(np.diag(result.covariance)) + 1e-9 * np.abs(stated)
        if (np.abs(stated - result.parameters) > 0.01 * sigma)[given].any():
            raise InputError(
                f"{where}: `parameters` are not those of `combinations`: leave one of them as it "
                "was, or set `combinations` to null"
            )
    parameters = np.where(given, result.parameters, np.nan)
    name = f"the prior {Path(where).name}"
    return TargetPrior(name, parameters, result.covariance, own, result.failures)
