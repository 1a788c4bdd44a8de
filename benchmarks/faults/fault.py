"""Faults, and the findings when they are injected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from benchmarks.faults.rig import Rig

RECOVERY = 5.0  # s, the goal


@dataclass(frozen=True, slots=True)
class FaultEffect:
    """Effect of a fault on the chain."""

    lost: str  # what was lost, in a few words
    kept: bool  # that this is no more than the contract states
    seconds: float  # until all was as before, inf when it never was
    said: str | None  # its diagnosis, None when they did not name it


Inject: TypeAlias = Callable[["Rig"], FaultEffect]


@dataclass(frozen=True, slots=True)
class Fault:
    """One entry of the campaign."""

    name: str  # on the command line
    what: str  # is done, in one line
    contract: str  # what may be lost, in one line
    inject: Inject  # does it, and looks
    limit: float = RECOVERY  # s in which all must be as before

    @property
    def is_shared(self) -> bool:
        """True if it is done to the chain that faults share; else to nodes of its own."""
        return hasattr(self.inject, "chain")


@dataclass(frozen=True, slots=True)
class FaultResult:
    """A fault and what was found; `problem` is why it failed, None when it did not."""

    fault: Fault
    finding: FaultEffect

    @property
    def problem(self) -> str | None:
        """The first goal that was missed."""
        if not self.finding.kept:
            return "lost more than the contract states"
        if not self.finding.seconds <= self.fault.limit:
            return f"took more than {self.fault.limit:g} s"
        if self.finding.said is None:
            return "not named in diagnostics"
        return None
