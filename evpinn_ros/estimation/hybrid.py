"""`mode: hybrid`: a filter at every sample, and once a second a windowed PINN update.

Prediction is physics plus a network: P = P_physics(v, a, grade; x) + trust N(v, a, age), which
fades once the battery is silent: the window shows what holds for a minute, not the car. The
physics is learned by the filter at every sample. The network is trained jointly with the physics
on the window and the store (`joint_step`), so it holds only what no parameters explain. A trained
network is a candidate: it is adopted if it foretells the following second, which it has not seen,
better than the network in use.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
import math
from typing import Any

import numpy as np

from evpinn_ros.estimation.estimate import ParameterSet
from evpinn_ros.estimation.grade_suspicion import GRADE_SIGN, GradeSuspicion
from evpinn_ros.estimation.joint_step import JointProblem, joint_step
from evpinn_ros.estimation.learner import LearnerReport, PowerPrediction, gate
from evpinn_ros.estimation.load_change import LoadDetector
from evpinn_ros.estimation.parameter_filter import CORRELATION_TIME
from evpinn_ros.estimation.parameter_set import StateKeeper, parameter_set
from evpinn_ros.estimation.power_filter import PowerFilter
from evpinn_ros.estimation.published_filter import PublishedFilter
from evpinn_ros.estimation.unknown_load import UnknownLoad
from evpinn_ros.estimation.window import Observation, SampleStore, SlidingWindow, batch
from evpinn_ros.estimation.window_network import WindowNetwork
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.signals.stream import SAMPLE_PERIOD
from evpinn_ros.signals.suspicion import CURRENT_SIGN, SignSuspicion
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.linear_power import LinearPower

WINDOW = 60.0  # s
WIDTHS = (3, 16, 16, 1)
SPEED_SCALE = 15.0  # m/s, network inputs are of order one
ACCELERATION_SCALE = 1.2  # m/s^2
PHYSICS_LOSS = 0.1  # lambda of eq. 22
RIDGE = 30.0  # pull of the network's weights to their start
MIN_SAMPLES = 100  # in the window, before the network is trained
THINNING = 3  # of the window: neighbours within `CORRELATION_TIME` say the same
MAX_STEP = 1.0  # s one sample may stand for
PARKED = 600.0  # s without speed, then it is another drive
TRUST_MEMORY = 300.0  # s of driving over which the network's merit is judged
TRUST_PRIOR = 200.0  # samples' worth of belief that the network is of no use


class HybridLearner:
    """See the module's text."""

    def __init__(self, vehicle: Vehicle, *, seed: int = 0) -> None:
        """Start at the vehicle's priors, with a network that says zero."""
        self._vehicle = vehicle
        self.parameter_filter = PublishedFilter(vehicle)
        self.power_filter = PowerFilter(vehicle)
        self._unknown_load = UnknownLoad()
        self._start = self._network = WindowNetwork.silent(WIDTHS, seed)
        self._candidate: WindowNetwork | None = None
        self._candidate_score = 0.0
        self._merit = _unproven()
        self._window = SlidingWindow(WINDOW)
        self._store = SampleStore()
        self._last_ns: int | None = None  # of what was learned from
        self._seen_ns: int | None = None  # of what was predicted
        self._payload = LoadDetector()
        self._suspicion = SignSuspicion()
        self._grade_suspicion = GradeSuspicion()
        self._states = StateKeeper()
        self.gated: Counter[str] = Counter()

    @property
    def trust(self) -> float:
        """Weight of the network, 0..1: regression of what physics left on what it said."""
        return float(np.clip(self._merit[0] / self._merit[1], 0.0, 1.0))

    def advance(self, sample: Sample) -> None:
        """Let time pass up to a smoothed sample.

        After a pause of `PARKED`, or before what was last seen, slope and drift are others. It is
        another drive, with other loads, when the two are that far apart: a clock that is set right
        by some seconds ends none.
        """
        seen_ns, self._seen_ns = self._seen_ns, sample.stamp_ns
        passed = 0.0 if seen_ns is None else (sample.stamp_ns - seen_ns) / NANOSECONDS
        if not 0.0 <= passed <= PARKED:
            self.power_filter.forget_time()
        if abs(passed) > PARKED:
            self.power_filter.end_drive()
        self.parameter_filter.advance(sample)
        self.power_filter.advance(sample)
        self._unknown_load.advance(sample.stamp_ns)

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power of physics and network, W."""
        physics = self.power_filter.predict(sample)
        power = physics.power + self._weight(sample) * self._said(self._network, sample)
        if not sample.course:
            # The newest moment: its acceleration is foretold, and what is wrong with it is larger
            # than the load; both together were worse on the drives measured.
            return PowerPrediction(power, physics.sigma)
        load, load_std = self._unknown_load.power(sample.speed)
        return PowerPrediction(power + load, math.hypot(physics.sigma, load_std))

    def observe(self, sample: Sample, power: float) -> None:
        """Learn from a measured sample, and judge the networks by what it surprised by."""
        step = self._step(sample)
        reason = gate(sample, power)
        if reason is not None:
            self.gated[reason] += 1
            return
        self._suspicion.push(sample, power, step)
        if self._suspicion.suspected:
            self.gated[CURRENT_SIGN] += 1
            return
        self.parameter_filter.update(sample, power, step)
        self._grade_suspicion.push(self.parameter_filter, sample, power, step)
        left = self.power_filter.update(sample, power, step)
        self._judge(sample, left, step)
        residual_std = self.power_filter.residual_std(sample)
        self._unknown_load.update(sample.speed, left, residual_std, step)
        self._follow_payload(sample, power, step)
        observation = Observation(sample, power, self.power_filter.slope)
        for old in self._window.add(observation):
            self._store.add(old)

    def prepare_update(self) -> Callable[[], WindowNetwork] | None:
        """Train a copy of the network on a snapshot of window and store."""
        window = list(self._window)
        if len(window) < MIN_SAMPLES or self._last_ns is None:
            return None
        observations = [*window[::-THINNING], *self._store]
        problem = self._problem(observations, self._last_ns)
        network, start = self._network, self._start.weights

        def work() -> WindowNetwork:
            return network.with_weights(joint_step(network, start, problem).weights)

        return work

    def consider(self, candidate: WindowNetwork) -> str | None:
        """Take a candidate to be judged; adopt the one before if the last second speaks for it."""
        judged, score = self._candidate, self._candidate_score
        finite = bool(np.isfinite(candidate.weights).all())
        self._candidate, self._candidate_score = (candidate if finite else None), 0.0
        if not finite:
            return "not_finite"
        if judged is None:
            return "not_judged_yet"
        if score <= 0.0:
            return "not_better"
        self._network = judged
        return None

    def parameters(self) -> ParameterSet:
        """Present estimate of the parameters, in the constant-efficiency sense of eq. 12-21."""
        told = self.parameter_filter.published()
        found = parameter_set(self._last_ns or 0, told)
        suspected = self._suspicion.suspected
        return self._states.judge(found, told.deviation()._asdict(), suspected=suspected)

    def linear_power(self, celsius: float | None) -> LinearPower:
        """The filter that predicts power, as forecasts take it."""
        return self.power_filter.linear_power(celsius)

    def report(self) -> LearnerReport:
        """Changes of payload, a current or grade of the wrong sign, and the lag of power."""
        lag, lag_std = self.power_filter.lag
        return LearnerReport(
            self._payload.change,
            self._payload.found,
            self._payload.withdrawn,
            self._suspected(),
            lag,
            lag_std,
        )

    def _suspected(self) -> str | None:
        """The signal whose sign the data contradict; without current nothing tells of grade."""
        if self._suspicion.suspected:
            return CURRENT_SIGN
        return GRADE_SIGN if self._grade_suspicion.suspected else None

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time; on another road the network is unproven."""
        self._window.clear()
        self._merit = _unproven()
        self._candidate = None
        self._last_ns = None
        self._payload.forget_time()
        self.parameter_filter.forget_time()
        self.power_filter.forget_time()
        self._unknown_load.forget()

    def end_drive(self) -> None:
        """Learn what the drive told of the loads it reported; the next has others."""
        self.power_filter.end_drive()

    def export(self) -> Mapping[str, Any]:
        """State to save."""
        return {
            "parameter_filter": self.parameter_filter.export(),
            "power_filter": self.power_filter.export(),
            "payload": self._payload.export(),
            "current_suspicion": self._suspicion.export(),
            "grade_suspicion": self._grade_suspicion.export(),
            "network": self._network.weights.tolist(),
            "seen_ns": self._seen_ns,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a saved state."""
        network = WindowNetwork(WIDTHS, state["network"])
        if not np.isfinite(network.weights).all():
            raise ValueError("the saved network is not finite")
        self.parameter_filter.restore(state["parameter_filter"])
        self.power_filter.restore(state["power_filter"])
        self._payload.restore(state["payload"])
        self._suspicion.restore(state["current_suspicion"])
        self._grade_suspicion.restore(state["grade_suspicion"])
        self._network = network
        self._merit = _unproven()
        self._seen_ns = None if state["seen_ns"] is None else int(state["seen_ns"])

    def _follow_payload(self, sample: Sample, power: float, step: float) -> None:
        """Let what is published follow a change of payload, and power once the change stood."""
        self.parameter_filter = self._payload.push(self.parameter_filter, sample, power, step)
        settled = self._payload.take_settled()
        if settled is not None:
            self.power_filter.shift_mass(*settled)

    def _step(self, sample: Sample) -> float:
        """Seconds this sample stands for."""
        last, self._last_ns = self._last_ns, sample.stamp_ns
        if last is None:
            return SAMPLE_PERIOD
        return min(MAX_STEP, max(1e-3, (sample.stamp_ns - last) / NANOSECONDS))

    def _weight(self, sample: Sample) -> float:
        """Of the network at a sample: what the window showed passes once nothing new is seen."""
        if self._last_ns is None:
            return 0.0
        unseen = max(0, sample.stamp_ns - self._last_ns) / NANOSECONDS
        return self.trust * math.exp(-unseen / WINDOW)

    def _said(self, network: WindowNetwork, sample: Sample) -> float:
        """What a network adds to the physics at a sample, W."""
        inputs = np.array([sample.speed, sample.acceleration, 0.0]) / _SCALES
        return network.at(inputs) * self.power_filter.residual_std(sample)

    def _judge(self, sample: Sample, residual: float, step: float) -> None:
        """Compare networks on what physics left, W, of a sample that none of them has seen."""
        scale = self.power_filter.residual_std(sample)
        left = residual / scale
        said = self._said(self._network, sample) / scale
        if self._candidate is not None:
            rival = self._said(self._candidate, sample) / scale
            self._candidate_score += (left - said) ** 2 - (left - rival) ** 2
        keep = 1.0 - min(1.0, step / TRUST_MEMORY)
        self._merit = keep * self._merit + np.array(
            [left * said, said**2 + (1.0 - keep) * TRUST_PRIOR]
        )

    def _problem(self, observations: list[Observation], newest_ns: int) -> JointProblem:
        data = batch(observations, newest_ns)
        power, gradient = self.power_filter.powers(data)
        scale = self.power_filter.residual_stds(data.speed)
        # What the store kept from before time went back is younger than the newest, and old.
        age = np.minimum(np.abs(data.age) / WINDOW, 1.0)
        return JointProblem(
            inputs=np.stack((data.speed, data.acceleration, age), axis=1) / _SCALES,
            residual=(data.power - power) / scale,
            gradient=gradient / scale[:, None],
            prior_precision=self.power_filter.prior_precision(),
            weight=THINNING * SAMPLE_PERIOD / CORRELATION_TIME,
            physics_loss=PHYSICS_LOSS,
            ridge=RIDGE,
        )


def _unproven() -> np.ndarray:
    """The merit of a network that has not been held against anything, shape (2,)."""
    return np.array([0.0, TRUST_PRIOR])


_SCALES = np.array([SPEED_SCALE, ACCELERATION_SCALE, 1.0])
