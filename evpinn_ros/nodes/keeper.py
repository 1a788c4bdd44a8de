"""Keeps the core of a node across restarts and jumps of time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from std_srvs.srv import Trigger

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import Half
from evpinn_ros.core.signals.time_jump import Jump, JumpPolicy, StampGuard
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.diagnosis import Condition, Health
from evpinn_ros.nodes.saved_state import StateFile, Stateful, state_path
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import Level
from evpinn_ros.topics.settings import jump_rule

SAVE_PERIOD = 60.0  # s
FILES = {Half.LEARNED: "state_file", Half.ENERGY: "energy_file"}  # parameters
ANEW = {Half.LEARNED: "begins with the vehicle file", Half.ENERGY: "counts from zero"}


class Actions(NamedTuple):
    """Actions of a node on its core."""

    reset: Callable[[], str]  # by the service ~/reset; returns its answer
    begin_anew: Callable[[], object]  # at a jump of time, by the policy `reset`
    hold: Callable[[], object]  # at a jump of time, by `hold`: keep the state, join nothing across


class Keeper:
    """Loads and saves the core of a node, orders its inputs, and handles jumps of time."""

    def __init__(
        self,
        node: GuardedNode,
        core: Stateful,
        half: Half,
        leaders: tuple[Topic, ...],
        actions: Actions,
    ) -> None:
        """Load the core's state; `leaders` are the main input, the first one shows jumps of time.

        Raises:
            InputError: the node is managed, and the file cannot be written or is in use.
        """
        if isinstance(before := getattr(node, "kept", None), Keeper):
            before.release()  # from a failed configuration
        self._node, self._leaders, self._actions = node, leaders, actions
        self._name = node.values[FILES[half]]
        self.file = StateFile(state_path(self._name), core, half)  # of the core
        self.guard = StampGuard(leaders[0])  # of the core's stamps
        self.guards = [self.guard]  # all guards of the node's stamps
        self._clock_went_back = False  # since the last jump
        if unwritable := self.file.why_unwritable():
            if node.values["managed"]:
                raise InputError(unwritable)
            node.log(Level.WARN, unwritable)
        self.file.restore()
        if self.file.busy is not None and node.values["managed"]:
            raise InputError(self.file.busy)
        self.start = self.file.start or ANEW[half]  # what the core starts from, in a few words
        if (problem := self.file.problem) is not None:
            node.log(Level.WARN, f"{node.get_name()} {self.start}: {problem}")
        node.create_service(Trigger, "~/reset", self._on_reset)
        node.create_service(Trigger, "~/save", self._on_save)
        node.every(SAVE_PERIOD, self.save)
        node.on_clock_going_back(self._on_clock_going_back)

    def release(self) -> None:
        """Release the file."""
        self.file.release()

    def condition(self, health: Health) -> Condition:
        """Condition of the node with this health."""
        age, silent = self._node.age(*self._leaders), self._node.why_silent(*self._leaders)
        return Condition(health, age, self.guard.jumps, self.file.problem, silent)

    def in_order(self, topic: Topic, stamp_ns: int, item: Any) -> Iterator[Any]:
        """Yields items in order of stamps; handles jumps of time between them."""
        for ready in self.guard.admit(topic, stamp_ns, item, jump_rule(self._node.values)):
            if isinstance(ready, Jump):
                self._on_jump(ready)
            else:
                yield ready

    def save(self) -> str | None:
        """Write the state if it has a file; returns the reason if that fails."""
        return self.file.save() if self._name else None

    def _on_clock_going_back(self) -> None:
        self._clock_went_back = True
        for guard in self.guards:
            guard.clock_went_back()

    def _on_jump(self, jump: Jump) -> None:
        policy = JumpPolicy(self._node.values["time_jump_policy"])
        if policy is JumpPolicy.AUTO:
            policy = JumpPolicy.RESET if self._clock_went_back else JumpPolicy.HOLD
        self._clock_went_back = False
        self._node.notice("jump", f"time went back by {jump.seconds:.1f} s: {policy.value}")
        if policy is JumpPolicy.RESET:
            self._actions.begin_anew()
        else:
            self._actions.hold()

    def _on_reset(self, _: Any, response: Any) -> Any:
        return self._node.respond(response, self._actions.reset())

    def _on_save(self, _: Any, response: Any) -> Any:
        return self._node.respond(response, f"written to {self._name}", self.file.save())
