"""The node `estimator`: learns from readings by `OnlineEstimator`; publishes its estimates."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
import time
from typing import Any

from std_srvs.srv import SetBool

from evpinn_ros import topics
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.core.estimation.estimator import Activity, EstimatorStatus, OnlineEstimator
from evpinn_ros.core.estimation.outputs import Outputs
from evpinn_ros.core.estimation.state_file import Half
from evpinn_ros.core.estimation.worker import ThreadWorker
from evpinn_ros.core.signals.admission import Admission, CarLimits
from evpinn_ros.core.signals.readings import Reading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.arrivals import StampWatch
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.diagnosis import WELL, Status
from evpinn_ros.nodes.estimator_diagnosis import estimator_phases, estimator_status
from evpinn_ros.nodes.factory import installed, new_message
from evpinn_ros.nodes.keeper import Actions, Keeper
from evpinn_ros.topics import Topic
from evpinn_ros.topics.estimates import breakdown_messages, estimate_messages
from evpinn_ros.topics.model import model_message
from evpinn_ros.topics.readings import to_reading
from evpinn_ros.topics.settings import estimator_settings, imu_mounting

MODEL_PERIOD = 10.0  # s
FOR_PLOTS = (topics.BATTERY_VOLTAGE, topics.BATTERY_CURRENT)
LISTENS_TO = tuple(topic for topic in topics.INPUTS if topic not in FOR_PLOTS)
PUBLISHES = tuple(topic for topic in topics.TOPICS if topic.source == "estimator")


class EstimatorNode(GuardedNode):
    """Learns one car; `docs` has its topics, services and parameters."""

    def __init__(self, **kwargs: Any) -> None:
        """Start from the state file, or anew; `kwargs` go to rclpy's Node.

        Raises:
            InputError: a parameter or a file is wrong.
        """
        super().__init__("estimator", **kwargs)

    def configure(self) -> None:
        """Start from the state file or the vehicle's priors."""
        # One BLAS thread: other programs need the cores, and sums keep their order.
        limit_blas_threads()
        self._vehicle = load_vehicle(self.values["vehicle"])
        self._worker = ThreadWorker(time.perf_counter, wait=self.values["wait_for_update"])
        self.estimator = OnlineEstimator(
            self._vehicle, estimator_settings(self.values), self._worker
        )
        self._admission = Admission(CarLimits.of(self._vehicle))
        self._mounting = imu_mounting(self.values)
        self._stamps = StampWatch()
        actions = Actions(self._reset, self._begin_anew, self._after_jump)
        self.kept = Keeper(self, self.estimator, Half.LEARNED, topics.SPEEDS, actions)
        self.advertise(*PUBLISHES)
        for topic in installed(LISTENS_TO):
            self.listen(topic, partial(self._take, topic))
        self.create_service(SetBool, "~/enable", self._on_enable)
        self.every(MODEL_PERIOD, self.publish_model)
        self.publish_model()
        car = f"{self._vehicle.key} ({self.values['mode']})"
        self.log_start(f"{car} {self.kept.start}; waiting for vehicle/speed", self.phases())

    def statuses(self) -> list[Status]:
        """The health of the estimate."""
        status = self.estimator.status()
        status = replace(status, dropped=Counter(status.dropped) + self._admission.refused)
        health = self.health(self.kept.guard.dropped, status.dropped, _usual(status))
        return [estimator_status(status, self.kept.condition(health))]

    def phases(self) -> list[Status]:
        """Activity, validity, and changes of payload."""
        return estimator_phases(self.estimator.status(), self.kept.condition(WELL))

    def publish_model(self) -> None:
        """Publish the car model for forecasts; latched, so a late subscriber has it at once."""
        model = self.estimator.model()
        if model is not None:
            self.publish([(topics.MODEL, model_message(new_message, self._vehicle.key, model))])

    def let_go(self) -> None:
        """Stop the thread of the updates, and release the state file."""
        self._worker.close()
        self.kept.release()

    def end(self) -> str | None:
        """Save the learned state; returns why it could not be saved."""
        return self.kept.save()

    def _reset(self) -> str:
        """Forget everything learned, also the state loaded at the start."""
        self.kept.file.forget()
        self.publish_model()
        return f"restarted from the vehicle file {self._vehicle.key}"

    def _begin_anew(self) -> None:
        """Return to the state of the start."""
        self._admission.begin_anew()
        self.kept.file.start_over()

    def _after_jump(self) -> None:
        """After a jump of time: keep what was learned, and join no reading across the jump."""
        self._admission.begin_anew()
        self.estimator.handle_time_jump()

    def _take(self, topic: Topic, message: Any) -> None:
        reading = to_reading(topic.type_name, message, self._mounting)
        topic = self.stream(topic)
        if topic is topics.SPEED:
            wrong = self._stamps.check(reading.stamp_ns, self.now_ns(), self.steady_s())
            if wrong is not None:
                self.notice("stamps", f"{topic.name}: {wrong}")
        for item in self.kept.in_order(topic, reading.stamp_ns, reading):
            if self._admission.admits(item):
                self._add(item)

    def _add(self, reading: Reading) -> None:
        """Give the estimator a reading, and publish its outputs."""
        now, completed = self.estimator.add_reading(reading, breakdowns=True)
        if now is not None:
            self.publish(estimate_messages(new_message, now))
        if completed is not None:
            self._publish_completed(completed)

    def _publish_completed(self, outputs: Outputs) -> None:
        for _, output in outputs.in_order():
            self.publish(estimate_messages(new_message, output))
        for learned in outputs.learned:  # once a second
            stamp_ns = learned.parameters.stamp_ns
            self.publish(breakdown_messages(new_message, stamp_ns, learned.breakdown))

    def _on_enable(self, request: Any, response: Any) -> Any:
        self.estimator.enabled = request.data
        return self.respond(response, "learning" if request.data else "paused: predicting only")


def _usual(status: EstimatorStatus) -> tuple[str, ...]:
    """Reasons for dropping readings that need no attention.

    A battery message may have only a state of charge, as long as others have power.
    """
    return () if status.activity is Activity.PREDICTING else ("battery_unmeasured",)
