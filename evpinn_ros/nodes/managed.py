"""Nodes that may be managed: all they work with is made when they are configured.

Without the parameter `managed` that is at once. With it `configure` reads parameters and files and
makes the endpoints, `activate` begins to work, and `cleanup` forgets all of it again.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn

from evpinn_ros import topics
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.base import NOT_ACTIVE, GuardedNode
from evpinn_ros.nodes.diagnosis import Status
from evpinn_ros.nodes.parameters import unknown_parameters
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import Level
from evpinn_ros.topics.node_parameters import TABLES, refuse_wrong

UNCONFIGURED = "it waits to be configured"


class ManagedNode(LifecycleNodeMixin, GuardedNode):
    """A node that works from the start, or with the parameter `managed` by its transitions."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        """Set the node up, if no manager does; `kwargs` go to rclpy's Node.

        Raises:
            InputError: a parameter is wrong.
        """
        GuardedNode.__init__(self, name, **kwargs)
        for problem in unknown_parameters(self, name):
            self.log(Level.WARN, problem)
        self._table, self._waits_for = TABLES[name], UNCONFIGURED
        self._made.clear()  # what was made so far is there as long as the node
        if not self.values["managed"]:
            self.configure()
            self.configured = True
            self.begin()
            return
        self.active = False
        LifecycleNodeMixin.__init__(self)
        # In place of a manager: a request may be lost while DDS matches those who just began.
        succeeded = TransitionCallbackReturn.SUCCESS
        if self.values["autostart"] and self.trigger_configure() is succeeded:
            self.trigger_activate()

    @abstractmethod
    def configure(self) -> None:
        """Make all that the node works with, from its parameters and files.

        Raises:
            InputError: one of them is wrong.
        """

    def let_go(self) -> None:
        """Undo `configure`, but for endpoints and timers, which are undone anyway."""

    def begin(self) -> None:
        """Open what the node holds while it works.

        Raises:
            InputError: it cannot be opened.
        """

    def end(self) -> str | None:
        """Let go of what the node holds while it works; gives what could not be kept and why."""
        return None

    def close(self) -> str | None:
        """End all, as the process does; gives what could not be kept and why."""
        problem = self.end() if self.active else None
        if self.configured:
            self.let_go()
        self.active = self.configured = False
        return problem

    def on_configure(self, state: Any) -> Any:
        """Read parameters and files anew; what is wrong fails the transition."""
        return self._transit(self._configure, super().on_configure, state)

    def on_activate(self, state: Any) -> Any:
        """Work."""
        return self._transit(self._activate, super().on_activate, state)

    def on_deactivate(self, state: Any) -> Any:
        """Stop working; what was learned is kept, in the file too."""
        return self._transit(self._deactivate, super().on_deactivate, state)

    def on_cleanup(self, state: Any) -> Any:
        """Forget all that `configure` made."""
        return self._transit(self._clean_up, super().on_cleanup, state)

    def on_shutdown(self, state: Any) -> Any:
        """Stop working for good, and forget all."""
        return self._transit(self._clean_up, super().on_shutdown, state)

    def on_error(self, state: Any) -> Any:
        """After a fault of our own: forget all, so that the node can be configured anew."""
        return self._transit(self._clean_up, super().on_error, state)

    def _transit(
        self, step: Callable[[], None], entities: Callable[[Any], Any], state: Any
    ) -> Any:
        try:
            step()
        except InputError as error:
            self._waits_for = str(error)
            self.log(Level.ERROR, f"{step.__name__.strip('_').replace('_', ' ')}: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.count_fault(f"{step.__name__.strip('_')}: {type(error).__name__}", str(error))
            return TransitionCallbackReturn.ERROR
        return entities(state)

    def _configure(self) -> None:
        try:
            refuse_wrong(self._table, self.values)
            self.configure()
        except InputError:
            self._clean_up()
            raise
        self.configured = True

    def _activate(self) -> None:
        self.begin()
        self.active = True

    def _deactivate(self) -> None:
        if self.active:
            self.active = False
            if problem := self.end():
                self.log(Level.WARN, problem)

    def _clean_up(self) -> None:
        self._deactivate()
        if self.configured:
            self.let_go()
        self.configured, self._waits_for = False, UNCONFIGURED
        self.forget_endpoints()

    def _diagnostics(self) -> Iterator[tuple[Topic, Any]]:
        if self.configured:
            yield from super()._diagnostics()
        else:
            waits = Status("lifecycle", Level.WARN, f"{NOT_ACTIVE}: {self._waits_for}", {})
            yield topics.DIAGNOSTICS, self.status_message([waits])

    def _log_changes(self) -> None:
        if self.configured:
            super()._log_changes()
