"""From the clock of an adapter to the node's clock, frame by frame.

A frame reaches us some delay after the adapter stamped it: a little when all is well, much when
USB or the scheduler gathers frames in a burst, but never less than nothing. So the difference of
the two clocks is the smallest that was seen (Cristian, "Probabilistic clock synchronization",
1989), let go slowly as the clocks drift apart. That is the lower envelope of the differences with
slopes up to `LARGEST_DRIFT_PPM` (Moon, Skelly and Towsley, "Estimation and removal of clock skew",
INFOCOM 1999, fit one line below them; ours may bend, as temperature bends the clocks).
"""

from __future__ import annotations

LARGEST_DRIFT_PPM = 500
"""Largest drift of the clocks: quartz 100 ppm each; NTP slews a computer's clock by 500 ppm."""
SET_ANEW_NS = 1_000_000_000
"""A delay of more is no delay: the node's clock was set forward, as NTP does after booting."""


class ClockMap:
    """Maps stamps of one adapter; frames come in the order in which it received them.

    While the clocks drift by less than r = `LARGEST_DRIFT_PPM`, with d the delay of a frame:

    - no stamp is before the moment of its frame, nor after the arrival: it is late by 0 to d;
    - nor is it late by more than `d_k + 2 r age_k` for any earlier frame k, so that one frame
      a second without delay holds all others to a millisecond;
    - no stamp is before the one before it.

    It begins anew when either clock goes back (an adapter that was reset, a clock set back) and
    when the node's clock leaps forward. Only a node's clock that goes back takes stamps with it.
    """

    def __init__(self) -> None:
        self._offset_ns = self._device_ns = self._now_ns = self._stamp_ns = 0
        self._started = False

    def convert(self, device_ns: int, now_ns: int) -> int:
        """The moment of a frame on the node's clock, ns.

        `device_ns` is the adapter's stamp, from a zero of its own; `now_ns` the node's clock when
        the frame was read.
        """
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
