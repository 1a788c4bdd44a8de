"""A car as it is saved: with names of its states, so that a new one voids no file."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import ADDED, Range
from evpinn_ros.core.estimation.bands import Bands
from evpinn_ros.core.estimation.gaussian import MOST, Gaussian, is_possible
from evpinn_ros.core.estimation.posterior import (
    DRIVES_KEPT,
    LEAST_SCALE,
    MOST_SCALE,
    PRIOR_DRIVES,
    CarState,
    initial_state,
)
from evpinn_ros.core.estimation.states import LASTING, NAMES, OFFSETS, SIZE, known_names
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.estimation.unevenness import (
    MOST_DRIVES,
    MOST_SHARE,
    MOST_SQUARES,
    SHAPE,
    Unevenness,
    prior_rows,
)
from evpinn_ros.core.signals.readings import TEMPERATURES

MOST_AWAY = 30.0  # prior sigmas, further no state was ever learned
MOST_EVIDENCE = 1e15
Numbers: TypeAlias = tuple[Annotated[float, Range(-(MOST**2), MOST**2)], ...]


@dataclass(frozen=True, slots=True)
class SavedState:
    """A `CarState` of K hypotheses and n named states.

    Attributes:
        names: of the states.
        mean: K n numbers.
        covariance: K n n numbers.
        offset_variance: n numbers, zero but for the offsets of a drive.
        evidence: shape (K,).
        scale: shape (K, 3).

    The rest is as in `CarState`.
    """

    names: tuple[str, ...]
    mean: Numbers
    covariance: Numbers
    offset_variance: Numbers
    evidence: Annotated[np.ndarray, Range(-MOST_EVIDENCE, 0.0)]
    scale: Annotated[np.ndarray, Range(LEAST_SCALE, MOST_SCALE)]
    bands: Bands
    drives: Annotated[float, Range(PRIOR_DRIVES, DRIVES_KEPT)]
    intervals: Annotated[int, Range(0, 10**12)]
    seconds: Annotated[float, Range(0.0, 1e9)]
    reports: bool
    celsius: Annotated[float, Range(*TEMPERATURES)] | None
    known: bool
    last_drive: Annotated[Annotated[float, Range(0.0, 1e9)] | None, ADDED] = None


# Fields that are saved as they are.
PLAIN = [field.name for field in fields(SavedState)][4:]


def saved_state(state: CarState) -> SavedState:
    """A state to save."""
    offsets = np.zeros(len(NAMES))
    offsets[OFFSETS] = state.offset_variance
    named = {"mean": state.mean, "covariance": state.covariance, "offset_variance": offsets}
    found: dict[str, Any] = {name: tuple(each.ravel().tolist()) for name, each in named.items()}
    return SavedState(NAMES, **found, **{name: getattr(state, name) for name in PLAIN})


def state_of(saved: SavedState, equation: Equation) -> CarState:
    """The state that was saved; a state that the file lacks is at its prior.

    Raises:
        ValueError: no drive leaves such a state: numbers are missing, it is no Gaussian, or the
            car is far from the prior of its vehicle file.
    """
    fresh = initial_state(equation)
    count, size = len(fresh.mean), len(saved.names)
    sizes = len(saved.mean), len(saved.covariance), len(saved.offset_variance)
    if sizes != (count * size, count * size * size, size) or len({*saved.names}) != size:
        raise ValueError("numbers of the states are missing")
    theirs, ours = known_names(saved.names)
    if not ours:
        raise ValueError("none of the states is known")
    mean, covariance = fresh.mean.copy(), fresh.covariance.copy()
    covariance[:, ours, :] = covariance[:, :, ours] = 0.0
    mean[:, ours] = np.reshape(saved.mean, (count, size))[:, theirs]
    own = np.reshape(saved.covariance, (count, size, size))
    covariance[:, np.array(ours)[:, None], ours] = own[:, np.array(theirs)[:, None], theirs]
    found = Gaussian(mean, covariance)
    prior = np.sqrt(np.diagonal(fresh.covariance, axis1=1, axis2=2))[:, LASTING]
    away = np.abs(mean - fresh.mean)[:, LASTING] / np.maximum(prior, 1e-9)
    if not (is_possible(found) and away.max() <= MOST_AWAY):
        raise ValueError("the state of the car is out of range")
    variance = np.zeros(len(NAMES))
    variance[OFFSETS] = fresh.offset_variance
    variance[ours] = np.array(saved.offset_variance)[theirs]
    if variance[OFFSETS].min() < 0.0:
        raise ValueError("a variance of the state is negative")
    plain = {name: getattr(saved, name) for name in PLAIN}
    plain["last_drive"] = saved.last_drive or 0.0
    return fresh.with_gaussian(found, offset_variance=variance[OFFSETS], **plain)


@dataclass(frozen=True, slots=True)
class SavedUnevenness:
    """An `Unevenness` with the names of its states."""

    names: tuple[str, ...]
    metres: Annotated[np.ndarray, Range(0.0, 1e12)]
    rows: tuple[Annotated[float, Range(-1e18, 1e18)], ...]
    squares: Annotated[float, Range(0.0, MOST_SQUARES)]
    drives: Annotated[float, Range(1.0, MOST_DRIVES)]


def saved_unevenness(found: Unevenness) -> SavedUnevenness:
    """Form that is saved."""
    rows = tuple(found.rows.ravel().tolist())
    return SavedUnevenness(NAMES, found.metres, rows, found.squares, found.drives)


def unevenness_of(saved: SavedUnevenness, equation: Equation) -> Unevenness:
    """Unevenness that was saved; a state that the file lacks has that of simulated drives.

    Raises:
        ValueError: numbers are missing or no car drives so.
    """
    if len(saved.rows) != SHAPE[0] * SHAPE[1] * len(saved.names):
        raise ValueError("numbers of the unevenness are missing")
    rows, (theirs, ours) = np.zeros((*SHAPE, SIZE)), known_names(saved.names)
    if len(ours) < SIZE:
        rows += saved.metres[..., None] * prior_rows(equation)
    rows[..., ours] = np.reshape(saved.rows, (*SHAPE, len(saved.names)))[..., theirs]
    found = Unevenness(saved.metres, rows, saved.squares, saved.drives)
    if found.share > MOST_SHARE:
        raise ValueError("the scatter of the unevenness is out of range")
    return found
