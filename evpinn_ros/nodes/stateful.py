"""Base of the nodes whose core outlives them in a file: load, save, reset, and jumps of time."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

from std_srvs.srv import Trigger

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import Half
from evpinn_ros.core.signals.time_jump import Jump, JumpPolicy, StampGuard
from evpinn_ros.nodes.diagnosis import Condition, Health
from evpinn_ros.nodes.managed import ManagedNode
from evpinn_ros.nodes.saved_state import StateFile, Stateful, state_path
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import Level
from evpinn_ros.topics.settings import jump_rule

SAVE_PERIOD = 60.0  # s


class StatefulNode(ManagedNode):
    """A node with a core that goes on where it was, after a restart and when time jumps.

    Attributes:
        NAME: of the node, its executable and its table of parameters.
        FILE: parameter that names the file.
        HALF: what it keeps there.
        ANEW: how the core begins without one.
        state_file: of the core.
        guard: of the stamps that the core is given.
    """

    NAME: ClassVar[str]
    FILE: ClassVar[str]
    HALF: ClassVar[Half]
    ANEW: ClassVar[str]

    def __init__(self, **kwargs: Any) -> None:
        """Start from the file, or anew; `kwargs` go to rclpy's Node.

        Raises:
            InputError: a parameter is wrong.
        """
        super().__init__(self.NAME, **kwargs)

    def go_on(self, core: Stateful, leader: Topic) -> str:
        """Load the core's state, and keep it from now on.

        Args:
            core: what is kept.
            leader: its input without which nothing works; its stamps decide on jumps of time.

        Returns:
            State that it begins with, in a few words.

        Raises:
            InputError: a manager asks for it, and the file can never be written.
        """
        path = state_path(self.values[self.FILE])
        self.state_file, self.guard = StateFile(path, core, self.HALF), StampGuard(leader)
        if unwritable := self.state_file.why_unwritable():
            if self.values["managed"]:
                raise InputError(unwritable)
            self.log(Level.WARN, unwritable)
        self.state_file.load()
        if (problem := self.state_file.problem) is not None:
            self.get_logger().warning(f"{self.get_name()} {self.ANEW}: {problem}")
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/save", self._on_save)
        self.every(SAVE_PERIOD, self.save)
        self._clock_went_back = False  # since the last jump
        self.on_clock_going_back(self._on_clock_going_back)
        return self.state_file.start or self.ANEW

    @abstractmethod
    def reset(self) -> str:
        """Begin anew, as a person asks for; gives the answer."""

    @abstractmethod
    def begin_anew(self) -> None:
        """Begin anew, for time jumped and the policy is `reset`."""

    @abstractmethod
    def hold(self) -> None:
        """Join nothing across a jump of time; what was learned or counted stays."""

    def stamp_guards(self) -> Iterator[StampGuard]:
        """All guards of stamps."""
        yield self.guard

    def condition(self, health: Health, *leading: Topic) -> Condition:
        """Condition of the node, `leading` being the inputs of which it needs either."""
        problem, silent = self.state_file.problem, self.why_silent(*leading)
        return Condition(health, self.age(*leading), self.guard.jumps, problem, silent)

    def in_order(self, topic: Topic, stamp_ns: int, item: Any) -> Iterator[Any]:
        """Items to be used now, in order, one of a topic having come; jumps of time are met.

        Args:
            topic: of the item.
            stamp_ns: of the item.
            item: given out once its stamp is not in doubt.
        """
        for each in self.guard.admit(topic, stamp_ns, item, jump_rule(self.values)):
            if isinstance(each, Jump):
                self._on_jump(each)
            else:
                yield each

    def save(self) -> str | None:
        """Write the state, if there is a file for it; gives the reason when that fails."""
        return self.state_file.save() if self.values[self.FILE] else None

    def end(self) -> str | None:
        """Save."""
        return self.save()

    def _on_clock_going_back(self) -> None:
        self._clock_went_back = True
        for guard in self.stamp_guards():
            guard.clock_went_back()

    def _on_jump(self, jump: Jump) -> None:
        policy = JumpPolicy(self.values["time_jump_policy"])
        if policy is JumpPolicy.AUTO:
            policy = JumpPolicy.RESET if self._clock_went_back else JumpPolicy.HOLD
        self._clock_went_back = False
        self.notice("jump", f"time went back by {jump.seconds:.1f} s: {policy.value}")
        if policy is JumpPolicy.RESET:
            self.begin_anew()
        else:
            self.hold()

    def _on_reset(self, _: Any, response: Any) -> Any:
        return self.done(response, self.reset())

    def _on_save(self, _: Any, response: Any) -> Any:
        problem = self.state_file.save()
        return self.done(response, f"written to {self.values[self.FILE]}", problem)
