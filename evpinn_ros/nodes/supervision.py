"""Messages to systemd about a process: that it is up, that it still works, that it ends.

The protocol is that of sd_notify(3): datagrams to the socket in NOTIFY_SOCKET. Without one, as
outside a unit of `Type=notify`, nothing is sent.
"""

from __future__ import annotations

from contextlib import suppress
import os
import socket

PATIENCE = 0.1  # s for a systemd that does not read: it must not hold up the callbacks


def tell(state: str) -> None:
    """Send one state, `READY=1`, `WATCHDOG=1` or `STOPPING=1`; who does not listen is ignored."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path  # of the abstract namespace
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as outlet:
        outlet.settimeout(PATIENCE)
        outlet.sendto(state.encode(), address)


def watchdog_period() -> float | None:
    """Seconds after which to say that all is well, half of what systemd waits; None: it does not.

    WATCHDOG_USEC, which systemd sets, is in microseconds.
    """
    waits = os.environ.get("WATCHDOG_USEC", "")
    return int(waits) / 2e6 if waits.isdecimal() and int(waits) > 0 else None
