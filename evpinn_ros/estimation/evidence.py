"""Evidence of the data on a car: the posterior of its parameters with the prior taken out.

A filter reports a posterior, prior times data. The data of several cars may be combined, but
their posteriors hold the same prior again and again, which would count as many times as there are
cars. So the population rests on the likelihood: precision and information of the posterior less
those of the prior.

Everything is expressed in prior sigmas about the prior, z = (x - x0) / sigma0, so the prior is
(0, 1), and a direction without data has precision 0, whatever its unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

LEAST_INFORMED = 0.1  # of the prior's variance; less is rounding, frozen states and forgetting
MOST_PRECISE = 1e-9  # of the prior's variance: a posterior narrower than this is no measurement
SIZE = len(PARAMETER_NAMES)


@dataclass(frozen=True, slots=True)
class Evidence:
    """A Gaussian likelihood of the parameters, exp(-z' precision z / 2 + information' z).

    Attributes:
        precision: shape (6, 6), symmetric, positive semidefinite.
        information: shape (6,), in the range of `precision`.
    """

    precision: np.ndarray
    information: np.ndarray


NO_EVIDENCE = Evidence(np.zeros((SIZE, SIZE)), np.zeros(SIZE))


def evidence(mean: np.ndarray, covariance: np.ndarray, published: np.ndarray) -> Evidence:
    """The evidence of a posterior, in prior sigmas about the prior.

    Args:
        mean: of all states, shape (n,), the parameters first.
        covariance: shape (n, n).
        published: the affine map from the states to what is published, [matrix, offset], shape
            (n, n + 1). It may move a parameter by states beyond the parameters, not these.

    States beyond the parameters keep their own prior and are integrated out. They must not be so
    before the prior is taken out: joined with it they would count as new data on each car.
    """
    precision, information = _without_prior(mean, covariance)
    back = np.linalg.inv(published[:, :-1])
    precision = back.T @ precision @ back
    information = back.T @ information + precision @ published[:, -1]
    rest = precision[SIZE:, SIZE:] + np.eye(len(mean) - SIZE)
    taken = np.linalg.solve(rest, precision[SIZE:, :SIZE]).T
    joined = precision[:SIZE, :SIZE] - taken @ precision[SIZE:, :SIZE]
    return _what_counts(joined, information[:SIZE] - taken @ information[SIZE:])


def _without_prior(mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Precision and information of a posterior less those of the prior (0, 1)."""
    variance, directions = np.linalg.eigh((covariance + covariance.T) / 2)
    inverse = 1.0 / np.maximum(variance, MOST_PRECISE)
    posterior = (directions * inverse) @ directions.T
    return posterior - np.eye(len(mean)), posterior @ mean


def _what_counts(precision: np.ndarray, information: np.ndarray) -> Evidence:
    """The directions with more information than `LEAST_INFORMED`; none of the others."""
    values, directions = np.linalg.eigh((precision + precision.T) / 2)
    counts = directions[:, values > LEAST_INFORMED / (1 - LEAST_INFORMED)]
    onto = counts @ counts.T
    kept = (counts * values[values > LEAST_INFORMED / (1 - LEAST_INFORMED)]) @ counts.T
    return Evidence(kept, onto @ information)
