"""Recorded drives through the chain, and their scores.

The public function `evpinn_ros.replay` (see `evpinn_ros.api.replay`) has this room's name, so the
room can be called: `import evpinn_ros as ev; ev.replay("drive.csv")` works whatever was imported.
"""

from importlib import import_module
import sys
from types import ModuleType
from typing import Any


class _Room(ModuleType):
    """A module that can be called."""

    @property
    def __wrapped__(self) -> Any:
        """The function, where `help` and `inspect` look for its signature."""
        return import_module("evpinn_ros.api").replay

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self.__wrapped__(*arguments, **options)


sys.modules[__name__].__class__ = _Room
