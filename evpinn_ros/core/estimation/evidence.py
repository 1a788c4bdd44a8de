"""Evidence of the data on a car: the posterior of its parameters with the prior taken out.

A posterior is prior times data. The data of several cars may be combined, but each posterior holds
the same prior, which would count once per car. So a population rests on the likelihood: precision
and information of the posterior less those of the prior.

Everything is expressed in sigmas of the vehicle file about its values, z = (x - x0) / sigma0 with
x the logarithms of the parameters, but for p_aux. So a direction without data has precision 0,
whatever its unit, and the evidence of several cars of a model adds up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES

LEAST_INFORMED = 0.1  # share of the prior's variance; less is rounding, drift and forgetting
MOST_PRECISE = 1e-9  # of the prior's variance: a posterior narrower than this is no measurement
SIZE = len(PARAMETER_NAMES)
LINEAR = "p_aux"  # may be zero, so its logarithm is not used


@dataclass(frozen=True, slots=True)
class Evidence:
    """A Gaussian likelihood of the parameters, exp(-z' precision z / 2 + information' z).

    Attributes:
        precision: shape (6, 6), symmetric, positive semidefinite.
        information: shape (6,), in the range of `precision`.
    """

    precision: np.ndarray
    information: np.ndarray

    def about(self, mean: np.ndarray, scale: np.ndarray) -> Evidence:
        """Likelihood as a function of (z - mean) / scale, shape (6,) each."""
        information = scale * (self.information - self.precision @ mean)
        return Evidence(self.precision * np.outer(scale, scale), information)


NO_EVIDENCE = Evidence(np.zeros((SIZE, SIZE)), np.zeros(SIZE))


def evidence(mean: np.ndarray, covariance: np.ndarray, prior: np.ndarray) -> Evidence:
    """The evidence of a posterior and the correlations of its prior, in sigmas of that prior."""
    after, before = _inverse(covariance), _inverse(prior)
    values, directions = np.linalg.eigh(after - before)
    counts = values > LEAST_INFORMED / (1.0 - LEAST_INFORMED)
    informed = directions[:, counts]
    precision = (informed * values[counts]) @ informed.T
    return Evidence(precision, informed @ informed.T @ (after @ mean))


def file_prior(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Mean and 1-sigma of the vehicle file, logarithms but for p_aux, shape (6,) each."""
    value = np.array([vehicle.priors[name].value for name in PARAMETER_NAMES])
    std = np.array([vehicle.priors[name].std for name in PARAMETER_NAMES])
    logarithmic = np.array([name != LINEAR for name in PARAMETER_NAMES])
    std[logarithmic] /= value[logarithmic]
    value[logarithmic] = np.log(value[logarithmic])
    return value, std


def _inverse(covariance: np.ndarray) -> np.ndarray:
    """Precision of a covariance, at most `1 / MOST_PRECISE` in any direction."""
    variance, directions = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray((directions / np.maximum(variance, MOST_PRECISE)) @ directions.T)
