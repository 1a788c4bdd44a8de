"""From the clock of an adapter to the node's clock, frame by frame.

A frame comes late, never early, so the difference of the clocks is the smallest seen (Cristian,
"Probabilistic clock synchronization", 1989), let go slowly as they drift: the lower envelope with
slopes up to `LARGEST_DRIFT_PPM` (Moon, Skelly and Towsley, INFOCOM 1999, fit one line).
"""

from __future__ import annotations

LARGEST_DRIFT_PPM = 500
"""Largest drift of the clocks: quartz 100 ppm each; NTP slews a computer's clock by 500 ppm."""
SET_ANEW_NS = 1_000_000_000
"""A delay of more is no delay: the node's clock was set forward, as NTP does after booting."""


class ClockMap:
    """Maps stamps of one adapter; frames come in the order in which it received them.

    No stamp is before its frame's moment, after its arrival, or before the stamp before it; nor
    later than `d_k + 2 r age_k` for any earlier frame k, r the drift and d the delay. It begins
    anew when either clock goes back and when the node's leaps forward.
    """

    def __init__(self) -> None:
        self._offset_ns = self._device_ns = self._now_ns = self._stamp_ns = 0
        self._started = False

    def convert(self, device_ns: int, now_ns: int) -> int:
        """The moment of a frame by the node's clock, ns, of its own stamp and its arrival."""
        difference = now_ns - device_ns
        elapsed = device_ns - self._device_ns
        highest = self._offset_ns - (-elapsed * LARGEST_DRIFT_PPM // 1_000_000)  # rounded up
        if (
            not self._started
            or elapsed < 0
            or now_ns < self._now_ns
            or difference > highest + SET_ANEW_NS
        ):
            self._started = True
            self._offset_ns, self._stamp_ns = difference, now_ns
        else:
            self._offset_ns = min(difference, highest)
            self._stamp_ns = max(device_ns + self._offset_ns, self._stamp_ns)
        self._device_ns, self._now_ns = device_ns, now_ns
        return self._stamp_ns
