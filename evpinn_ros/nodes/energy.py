"""The node `energy`: integrates power to energy, and forecasts the energy of plans."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy, deepcopy
from functools import partial
import math
from typing import Any

import numpy as np
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from evpinn_ros import topics
from evpinn_ros.core.energy.account import AccountSummary, EnergyAccount
from evpinn_ros.core.energy.forecaster import Basis, Forecaster, PlanAnswer, PlanLog
from evpinn_ros.core.energy.meter import EnergyMeter, EnergyState, Integrator
from evpinn_ros.core.energy.path_plan import NOMINAL_SPEED
from evpinn_ros.core.energy.plan import PlanError
from evpinn_ros.core.energy.remaining import usual_cost
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.energy.standby import MeasuredPower, Standby
from evpinn_ros.core.estimation.state_file import Half
from evpinn_ros.core.signals.admission import CarLimits
from evpinn_ros.core.signals.readings import BatteryReading, why_impossible
from evpinn_ros.core.signals.time_jump import Jump, StampGuard
from evpinn_ros.core.signals.track import LATER
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.base import NOT_ACTIVE, GuardedNode
from evpinn_ros.nodes.diagnosis import WELL, Status
from evpinn_ros.nodes.energy_diagnosis import (
    answered_status,
    charge_status,
    energy_phases,
    meter_status,
    plan_status,
)
from evpinn_ros.nodes.factory import decode, installed, is_installed, message_class, new_message
from evpinn_ros.nodes.keeper import Actions, Keeper
from evpinn_ros.nodes.plan_answers import BATCH, SERVICE, Job, Moment, PlanCall, PlanDesk
from evpinn_ros.nodes.typed import (
    PACKAGE,
    PLAN_ACTION,
    PLAN_SERVICE,
    TYPED_FORECAST,
    assumed_conditions,
)
from evpinn_ros.topics import Topic
from evpinn_ros.topics.energies import output_messages
from evpinn_ros.topics.estimates import read_identifiable, read_power
from evpinn_ros.topics.messages import BadMessage, Level
from evpinn_ros.topics.model import read_model
from evpinn_ros.topics.plans import (
    forecast_message,
    plan_of_message,
    question,
    read_conditions,
)
from evpinn_ros.topics.readings import ChargeScale, battery_message, to_reading
from evpinn_ros.topics.settings import jump_rule

PUBLISHES = tuple(topic for topic in topics.TOPICS if topic.source == "energy")
COUNT_PERIOD = 0.2  # s, as the estimator publishes; counting many powers costs as much as one
AT_ONCE = 1000  # points of a plan that the callback itself answers, in 1.5 ms


class EnergyNode(GuardedNode):
    """Meters the energy of one car and answers plans; its interfaces are in `docs`."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("energy", **kwargs)

    def configure(self) -> None:
        """Start from the energy file, or at zero."""
        vehicle = load_vehicle(self.values["vehicle"])
        integrator, max_gap = Integrator(self.values["integrator"]), self.values["max_gap"]
        meter = EnergyMeter(load_rknn(), integrator=integrator, max_gap=max_gap)
        limits = CarLimits.of(vehicle)
        self.account = EnergyAccount(meter, vehicle.key, vehicle.battery_capacity, limits)
        self._vehicle = vehicle
        # Equal forecasters: one for callbacks, the other for the thread of the desk.
        self.forecaster, self._desk = Forecaster(vehicle), PlanDesk(Forecaster(vehicle))
        account = self.account
        anew, hold = (
            partial(self._after_counting, begin)
            for begin in (account.begin_next_trip, account.begin_after_jump)
        )
        actions = Actions(self._reset, anew, hold)
        self.kept = Keeper(self, account, Half.ENERGY, (topics.POWER_SMOOTHED,), actions)
        # A guard of its own: in a fast replay readings are seconds ahead of power.
        self._reading_guard, self._charge_scale = StampGuard(topics.SPEED), ChargeScale()
        self.kept.guards.append(self._reading_guard)
        self._standby = Standby(self.steady_s())
        self.plans = PlanLog()
        self.advertise(*PUBLISHES)
        self.every(COUNT_PERIOD, self.count)
        for topic in (topics.POWER_MEASURED, topics.POWER_SMOOTHED):
            self.listen(topic, partial(self._take_power, topic))
        self.listen(topics.IDENTIFIABLE, self._on_identifiable)
        for topic in installed((*topics.SPEEDS, topics.BATTERY)):
            self.listen(topic, partial(self._on_reading, topic))
        self.listen(topics.MODEL, self._on_model)
        for topic in (topics.TEMPERATURE, topics.PRESSURE, topics.WIND):
            self.listen(topic, partial(self._on_air, topic))
        self.listen(topics.CONDITIONS, self._on_conditions)
        for topic in installed((topics.PLAN, topics.SPEED_PROFILE, topics.TRAJECTORY)):
            self.listen(topic, partial(self._on_plan, topic.type_name), raw=True)
        if is_installed(PACKAGE):
            self.advertise(TYPED_FORECAST)
            self._serve_plans()
        self.log_start(
            f"{vehicle.key} {self.kept.start}; waiting for power/smoothed", self.phases()
        )

    def let_go(self) -> None:
        """Stop answering plans, and release the state file."""
        self._desk.close()
        self.kept.release()

    def statuses(self) -> list[Status]:
        """The health of the meter and of the planning."""
        dropped = sum((guard.dropped for guard in self.kept.guards), self.account.refused)
        condition = self.kept.condition(self.health(dropped))
        air = self.forecaster.air(self.now_ns())
        return [
            meter_status(self.account, condition),
            charge_status(self.account),
            plan_status(self.plans, self.forecaster.basis, air),
        ]

    def phases(self) -> list[Status]:
        """The metered input, and the basis of forecasts."""
        condition = self.kept.condition(WELL)
        return energy_phases(self.account, self.forecaster.basis, condition)

    def end(self) -> str | None:
        """Save totals and account; returns why they could not be saved."""
        self.count()
        self.account.flush()
        return self.kept.save()

    def _reset(self) -> str:
        self._after_counting(self.account.reset_trip)
        return "energy of the trip is zero; the lifetime's total continues"

    def _take_power(self, topic: Topic, message: Any) -> None:
        estimate = read_power(topic, message)
        self._count_missed(self._standby.hear(estimate.stamp_ns, self.steady_s()))
        for admitted in self.kept.in_order(topic, estimate.stamp_ns, estimate):
            self.account.add_power(admitted)

    def _count_missed(self, powers: list[MeasuredPower]) -> None:
        """Count measured powers from the time without an estimator."""
        if not powers:
            return
        self.account.add_measured(*map(np.array, zip(*powers, strict=True)))
        self.account.flush()
        self._publish_account(self.account.state)

    def count(self) -> None:
        """Count new powers and readings; publish states, and once a second the summary."""
        while (due_ns := self.account.summary_due_ns()) != LATER:
            self._publish_account(*self.account.count(due_ns).rows())
        self._publish_account(*self.account.count().rows())

    def _after_counting(self, begin: Callable[[], None]) -> None:
        self.count()
        begin()

    def _publish_account(self, *states: EnergyState) -> None:
        """Publish states, and the summary once a second."""
        summary = self.account.tick()
        shown: tuple[EnergyState | AccountSummary, ...] = states
        if summary is not None:
            shown = (*states, summary)
        if not shown:
            return
        self.kept.file.append()  # before publishing, so that no published total falls after a kill
        for output in shown:
            self.publish(output_messages(new_message, output))

    def _on_identifiable(self, message: Any) -> None:
        values, sigmas = read_identifiable(message)
        try:
            self._learn(lambda forecaster: forecaster.set_identifiable(values, sigmas))
        except ValueError as error:
            raise BadMessage(str(error)) from error

    def _on_reading(self, topic: Topic, message: Any) -> None:
        reading = self._charge_scale.reading(to_reading(topic.type_name, message))
        topic = self.stream(topic)
        rule = jump_rule(self.values)
        for passed in self._reading_guard.admit(topic, reading.stamp_ns, reading, rule):
            if isinstance(passed, Jump):  # the policy applies to jumps of power
                self._after_counting(self.account.begin_readings_anew)
            elif self.account.admission.admits(passed):
                self.account.add_reading(passed)
                if isinstance(passed, BatteryReading):
                    self._count_missed(self._standby.take(passed, self.steady_s()))

    def _on_model(self, message: Any) -> None:
        model = read_model(message, self._vehicle)
        self._learn(lambda forecaster: forecaster.set_model(model))
        self.account.usual = usual_cost(model)

    def _on_air(self, topic: Topic, message: Any) -> None:
        reading: Any = to_reading(topic.type_name, message)
        reason = why_impossible(reading)
        if reason is not None:
            raise BadMessage(reason)
        now_ns = self.now_ns()
        self._learn(lambda forecaster: forecaster.set_air(reading, now_ns))

    def _on_conditions(self, message: Any) -> None:
        try:
            conditions = read_conditions(message)
        except BadMessage as error:  # or its planner would take the next answer for that to it
            text = f"plan/conditions refused ({error.__cause__ or error}); those before hold"
            self.notice(topics.CONDITIONS.name, text)
            raise
        self._learn(lambda forecaster: forecaster.set_conditions(conditions))

    def _learn(self, update: Job) -> None:
        """Update both forecasters; a wrong update raises before it reaches the second."""
        update(self.forecaster)
        self._desk.tell(update)

    def _on_plan(self, type_name: str, data: bytes) -> None:
        """Ask the desk for an answer to a plan; its thread also unpacks the bytes."""
        moment, start_speed = self._moment(), self.account.speed
        job = partial(self._answer_plan, type_name, data, moment, start_speed)
        if not self._desk.ask(self.guarded(job, "plan")):
            header = decode("std_msgs/msg/Header", data)  # the first field of every plan
            self._refuse(header, "too many plans are waiting")

    def _answer_plan(
        self,
        type_name: str,
        data: bytes,
        moment: Moment,
        start_speed: float,
        forecaster: Forecaster,
    ) -> None:
        """Answer a plan, or refuse it with the reason, even after an internal fault."""
        header = new_message("std_msgs/msg/Header")
        try:
            header = decode("std_msgs/msg/Header", data)
            speeds = self._speed(), start_speed
            asked, plan = question(header), plan_of_message(type_name, data, decode, *speeds)
            answer = forecaster.answer(plan, *moment, asked)
            messages = list(self._plan_messages(header, answer, forecaster.basis))
        except (BadMessage, PlanError) as error:
            self._refuse(header, str(error))
            return
        except Exception as error:
            self._refuse(header, f"internal fault: {type(error).__name__}")
            raise
        self.publish(messages)
        self.plans.answer(answer.charge)
        if asked.together is None:  # a plan asked together with others is not followed yet
            self.account.follow(answer.forecast.curve)

    def _speed(self) -> float:
        """Assumed speed of a path without times, m/s."""
        nominal = self._vehicle.nominal_speed
        return self.values["nominal_speed"] or (NOMINAL_SPEED if math.isnan(nominal) else nominal)

    def _refuse(self, header: Any, reason: str) -> None:
        self.publish([self._plan_status(header, Status("plan", Level.WARN, reason, {}))])
        self.plans.refuse(reason)

    def _plan_status(self, header: Any, status: Status) -> tuple[Topic, Any]:
        message = self.status_message([status])
        message.header = header
        return topics.FORECAST_STATUS, message

    def _plan_messages(
        self, header: Any, answer: PlanAnswer, basis: Basis
    ) -> Iterator[tuple[Topic, Any]]:
        """Messages of an answer to a plan, with the plan's header."""
        result = answer.forecast
        times = result.time - result.time[0]
        columns = (result.energy, result.power, result.sigma)
        yield topics.FORECAST, forecast_message(new_message, header, times, *columns)
        if is_installed(PACKAGE):
            names = ("energy", "power", "sigma")
            numbers = dict(zip(names, (column.tolist() for column in columns), strict=True))
            typed = new_message(TYPED_FORECAST.type_name, time=times.tolist(), **numbers)
            typed.header, typed.basis = header, basis.value
            typed.conditions = list(answer.conditions)
            typed.assumed = assumed_conditions(answer.assumed)
            yield TYPED_FORECAST, typed
        if answer.charge.known:
            reading = BatteryReading(0, answer.voltage, math.nan, answer.charge.value)
            battery = battery_message(new_message, reading)
            battery.header = header
            yield topics.FORECAST_BATTERY, battery
        yield self._plan_status(header, answered_status(answer))

    def _moment(self) -> Moment:
        charge, capacity = self.account.charge(), self.account.gauge.capacity
        return Moment(charge, capacity, self.now_ns(), deepcopy(self.account.battery))

    def _serve_plans(self) -> None:
        from rclpy.action import ActionServer, CancelResponse  # here: only with evpinn_msgs

        # In an exclusive group, a call that waits for its answer would block all others.
        group = ReentrantCallbackGroup()
        kind = message_class(PLAN_SERVICE)
        self.create_service(kind, "~/estimate_plan", self._on_estimate, callback_group=group)
        server = ActionServer(
            self,
            message_class(PLAN_ACTION),
            "~/estimate_plans",
            self._on_batch,
            callback_group=group,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._made.append(server.destroy)

    async def _on_estimate(self, request: Any, response: Any) -> Any:
        call, moment = PlanCall(request, SERVICE, self.plans), self._moment()

        def answer_all(forecaster: Forecaster) -> None:
            while not call.finished:
                call.answer(forecaster, moment)

        if self.active and len(request.plans) == 1 and len(request.plans[0].time) <= AT_ONCE:
            self._answering(call, answer_all)(self.forecaster)
        else:
            await self._at_the_desk(call, answer_all)
        return call.write(response)

    async def _on_batch(self, goal: Any) -> Any:
        """Answer a goal plan by plan, all with the same model; other calls may come between."""
        self.calls["~/estimate_plans"] += 1
        kind = message_class(PLAN_ACTION)
        call, moment = PlanCall(goal.request, BATCH, self.plans), self._moment()
        forecasters: list[Forecaster] = []

        def answer_next(forecaster: Forecaster) -> None:
            if not forecasters:
                forecasters.append(copy(forecaster))
            call.answer(forecasters[0], moment)

        while not (call.finished or goal.is_cancel_requested):
            await self._at_the_desk(call, answer_next)
            goal.publish_feedback(kind.Feedback(done=len(call.results), newest=call.results[-1]))
        if call.finished:
            goal.succeed()
        else:
            goal.canceled()
        return call.write(kind.Result())

    async def _at_the_desk(self, call: PlanCall, job: Job) -> None:
        """Run a job in the thread of the desk; refuse the plans of its call if it cannot run."""
        if not self.active:
            call.refuse_all(NOT_ACTIVE)
            return
        executor = self.executor
        answered = Future(executor=executor)
        answer = self._answering(call, job)

        def answer_and_wake(forecaster: Forecaster) -> None:
            answer(forecaster)
            answered.set_result(None)
            executor.wake()  # rclpy's `await` adds no callback to wake the executor

        if self._desk.ask(answer_and_wake):
            await answered
        else:
            call.refuse_all("too many plans are waiting")

    def _answering(self, call: PlanCall, job: Job) -> Callable[[Forecaster], None]:
        """Wrap a job, so that an internal fault refuses the plans of its call."""

        def answer(forecaster: Forecaster) -> None:
            try:
                job(forecaster)
            except Exception as error:
                call.refuse_all(f"internal fault: {type(error).__name__}")
                raise

        return self.guarded(answer, "estimate_plan")
