"""Growth of an error of power into an error of energy.

Model: the error of power is sigma(t) u(t), with u a stationary Gauss-Markov process of unit
variance and correlation exp(-|s| / tau). The error of energy then is a double integral that has a
closed form for constant sigma:

    variance(t) = 2 sigma^2 tau (t - tau (1 - exp(-t / tau)))

which is (sigma t)^2 for t << tau, where the error is a constant offset, and 2 tau sigma^2 t for t
>> tau, where it is a random walk. Independent errors (tau -> 0) would give a far too small sigma;
an offset for the whole drive (tau -> infinity) a far too large one.

That is the error of minutes. A difference between the car and the learned one (tyres, wind, a cold
battery) lasts: without the battery nothing corrects it, and the error of energy is proportional to
gross energy, drawn and regenerated together. The hybrid learner gives the sigma of a dropout
itself; `mode: paper` uses `LASTING_SHARE`.

Power between the samples of a sensor adds a variance too: see `sampled`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from evpinn_ros.common.arrays import namespace

# From the spread of the energy error over 60 s windows, in the second half of a Model 3 drive
# and twelve BMW i3 drives, with parameters fitted to the first half: median 4.5 s, 1.8 to 30 s.
CORRELATION_TIME = 5.0  # s
# From twelve BMW i3 trips, each predicted without its battery after the trips before it.
LASTING_SHARE = 0.06
# Chosen on two drives of a Model 3 and two of an i3, thinned to 1 .. 10 s. On 30 drives of another
# car (Changchun) totals by trapezoids were off by 0.75 sigma as root mean square of readings 1 s
# apart, by 1.2 to 1.35 of those 2 to 10 s apart, and by 4.1 at most.
POWER_MEMORY = 2.5  # s, time constant of power in traffic


def relaxed(elapsed: Any, memory: float) -> Any:
    """Integral of exp(-t / memory) over the time elapsed, both in s; elementwise, any library."""
    return -memory * namespace(elapsed).expm1(-elapsed / memory)


def walked(elapsed: Any, memory: float) -> Any:
    """Variance of the integral of u, s^2, over the time elapsed; tau, s, is `memory`."""
    return 2 * memory * (elapsed - relaxed(elapsed, memory))


def sampled(steps: np.ndarray, rises: np.ndarray) -> np.ndarray:
    """Variance of the energy of steps, J^2, shape (n,), from the rise of power, W, over each.

    Power is modelled as a Gauss-Markov process whose variance follows from the rises. For short
    steps the result is that of a Brownian bridge, rise^2 step^2 / 12; for long ones, whose samples
    are independent, six times that.
    """
    half = steps / (2.0 * POWER_MEMORY)
    share = (1.0 / np.tanh(half) - 1.0 / half) / (-2.0 * np.expm1(-2.0 * half))
    variances: np.ndarray = share * (rises * steps) ** 2
    return variances


class CorrelatedError:
    """Error of an integral whose sigma changes from step to step.

    Keeps the variance of the energy and its covariance with u. A sigma of NaN makes the result
    NaN from there on: an integral with an unknown part is unknown.
    """

    def __init__(self, start_sigma: float = 0.0) -> None:
        """Start; start_sigma: 1-sigma of the energy so far, J, independent of later errors."""
        self._covariance = 0.0
        self._variance = start_sigma**2

    @property
    def sigma(self) -> float:
        """1-sigma of the energy, J."""
        return math.sqrt(self._variance)

    def integrate(
        self, sigmas: np.ndarray, steps: np.ndarray, besides: np.ndarray | None = None
    ) -> np.ndarray:
        """Integrate over n steps, s, with a 1-sigma of power, W, constant in each.

        `besides` are independent variances of the energy of the steps, J^2.
        Returns the variance of the energy after 0 to n steps, J^2, shape (n + 1,).
        """
        tau = CORRELATION_TIME
        forgotten = relaxed(steps, tau) / tau  # 1 - exp(-dt / tau)
        within = np.maximum(sigmas * tau * (steps - tau * forgotten), 0.0)
        extra = np.zeros(len(steps)) if besides is None else besides
        variances = [self._variance]
        columns = sigmas, forgotten, within, extra
        for sigma, share, inside, beside in zip(*(c.tolist() for c in columns), strict=True):
            self._variance += 2 * sigma * (self._covariance * tau * share + inside) + beside
            self._covariance += (sigma * tau - self._covariance) * share
            variances.append(self._variance)
        return np.array(variances)
