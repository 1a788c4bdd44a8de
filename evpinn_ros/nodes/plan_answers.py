"""Answers plans on a worker thread; fills the answers of `EstimatePlan` and `EstimatePlans`."""

from __future__ import annotations

from collections.abc import Callable
import math
from queue import SimpleQueue
import threading
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecaster import Forecaster, PlanAnswer, PlanLog
from evpinn_ros.core.energy.plan import Plan, PlanError, Question, plan_from_speed_profile
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.typed import PLAN_RESULT, assumed_conditions, given_conditions

UNKNOWN = dict.fromkeys(("energy", "energy_sigma", "end_charge", "end_charge_sigma"), math.nan)
MOST_WAITING = 100  # plans or calls; further ones are refused
LONGEST_STOP = 5.0  # s to wait for the current plan; the thread is a daemon

Job: TypeAlias = Callable[[Forecaster], object]


class PlanDesk:
    """Runs jobs one after the other in a thread that owns a forecaster."""

    def __init__(self, forecaster: Forecaster) -> None:
        self._forecaster = forecaster
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._places = threading.Semaphore(MOST_WAITING)
        self._thread = threading.Thread(target=self._work, name="plans", daemon=True)
        self._thread.start()

    def tell(self, update: Job) -> None:
        """Queue an update of the forecaster; jobs queued later use it."""
        self._jobs.put(update)

    def ask(self, job: Job) -> bool:
        """Queue a job that answers a plan and must not raise; False if too many wait."""
        if not self._places.acquire(blocking=False):
            return False

        def counted(forecaster: Forecaster) -> None:
            try:
                job(forecaster)
            finally:
                self._places.release()

        self._jobs.put(counted)
        return True

    def close(self) -> None:
        """Drop waiting jobs, and end the thread after the current one."""
        while not self._jobs.empty():
            self._jobs.get()
        self._jobs.put(None)
        self._thread.join(LONGEST_STOP)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            job(self._forecaster)


class Moment(NamedTuple):
    """State of the battery and time at which a plan is answered."""

    charge: Uncertain
    capacity: Uncertain
    now_ns: int
    battery: BatteryModel


class CallLimits(NamedTuple):
    """Most plans of a call, and most points of all of them together."""

    plans: int
    points: int


SERVICE = CallLimits(100, 2_000_000)
"""Limits of a request of the service: some seconds of work without progress for the caller."""
BATCH = CallLimits(1000, 20_000_000)
"""Limits of a goal of the action, which has feedback and can be cancelled."""


class PlanCall:
    """The plans of one call, answered one by one."""

    def __init__(self, request: Any, limits: CallLimits, log: PlanLog) -> None:
        """Take the plans of a request or goal; those beyond the limits will be refused."""
        self._plans, self._given = request.plans, request.conditions
        self._limits, self._log = limits, log
        self.results: list[Any] = []  # evpinn_msgs/PlanResult of the plans so far, in order
        self._points, self._together = 0, object()
        # Energy that plan i takes more than plan j, and its 1-sigma.
        self._more, self._sigma = np.full((2, *[len(self._plans)] * 2), math.nan)
        self._basis = ""
        self._answered: PlanAnswer | None = None  # the last answer

    @property
    def finished(self) -> bool:
        """Whether every plan has its result."""
        return len(self.results) == len(self._plans)

    def answer(self, forecaster: Forecaster, moment: Moment) -> None:
        """Answer or refuse the next plan, and compare it with those before."""
        index, self._basis = len(self.results), forecaster.basis.value
        asked = self._plans[index]
        result = new_message(PLAN_RESULT, name=asked.name, **UNKNOWN)
        try:
            self._refuse_too_many(asked)
            given = given_conditions(self._given)
            question = Question(str(index), self._together, given, along=False)
            self._fill(result, index, forecaster.answer(_plan(asked), *moment, question))
        except PlanError as error:
            result.refusal = str(error)
            self._log.refuse(result.refusal)
        self._set_differences(result, index)
        self.results.append(result)

    def refuse_all(self, reason: str) -> None:
        """Refuse every plan without a result, with this reason."""
        for asked in self._plans[len(self.results) :]:
            result = new_message(PLAN_RESULT, name=asked.name, refusal=reason, **UNKNOWN)
            self.results.append(result)

    def write(self, response: Any) -> Any:
        """Fill the response of the service or the result of the action with the results so far."""
        for index, result in enumerate(self.results):
            self._set_differences(result, index)
        response.results, response.basis = self.results, self._basis
        if self._answered is not None:
            response.conditions = list(self._answered.conditions)
            response.assumed = assumed_conditions(self._answered.assumed)
        return response

    def _refuse_too_many(self, asked: Any) -> None:
        if len(self.results) >= self._limits.plans:
            raise PlanError(f"more than {self._limits.plans} plans")
        self._points += len(asked.time)
        if self._points > self._limits.points:
            raise PlanError(f"more than {self._limits.points} points with the plans before it")

    def _fill(self, result: Any, index: int, answer: PlanAnswer) -> None:
        self._log.answer(answer.charge)
        self._answered = answer
        result.energy = float(answer.forecast.energy[-1])
        result.energy_sigma = float(answer.forecast.sigma[-1])
        result.end_charge, result.end_charge_sigma = map(float, answer.charge)
        self._more[index, index] = self._sigma[index, index] = 0.0
        for name, apart in answer.differences.items():
            other = int(name)
            self._more[index, other], self._more[other, index] = apart.value, -apart.value
            self._sigma[index, other] = self._sigma[other, index] = apart.sigma

    def _set_differences(self, result: Any, index: int) -> None:
        result.more, result.more_sigma = self._more[index].tolist(), self._sigma[index].tolist()


def _plan(asked: Any) -> Plan:
    time, distance, speed, elevation = (
        np.array(column, dtype=float)
        for column in (asked.time, asked.distance, asked.speed, asked.elevation)
    )
    return plan_from_speed_profile(time, distance, speed, elevation if elevation.size else None)
