"""ELM327-emulator (PyPI) as a process of its own: a Kona behind an adapter, on a pty or over TCP.

Run: python elm327_emulator.py KIND [TCP_PORT]; prints the port, and ends with its stdin. The
emulator makes the frames of long answers; what they hold is set here.
"""

from random import Random
import sys

from elm import Elm
from elm.obd_message import ELM_FOOTER, iso_tp_frames

VOLTAGE, CURRENT, SPEED_KMH, CHARGE = 404.7, -12.3, 88, 0.64


def scenario(kind: str) -> dict:
    """Answers to the two requests of the profile `hyundai_kia`."""
    pack = bytearray(59)
    pack[4] = round(CHARGE * 200)
    pack[10:12] = round(CURRENT * 10).to_bytes(2, "big", signed=True)
    pack[12:14] = round(VOLTAGE * 10).to_bytes(2, "big")
    pack[29] = 142  # of the 12 V battery
    drive = bytearray(30)
    drive[29] = SPEED_KMH
    answers = {
        "pack": ("220101", "7E4", iso_tp_frames(hexed(b"\x62\x01\x01" + pack), "7EC")),
        "drive": ("220100", "7B3", iso_tp_frames(hexed(b"\x62\x01\x00" + drive), "7BB")),
    }
    return {
        name: {
            "Request": f"^{asked}{ELM_FOOTER}",
            "Descr": name,
            "Header": header,
            "Response": spoiled(kind, answer),
        }
        for name, (asked, header, answer) in answers.items()
    }


def hexed(data: bytes) -> list[str]:
    """Each byte as two digits."""
    return [f"{byte:02X}" for byte in data]


def spoiled(kind: str, answer: str) -> list[str]:
    """Answers of an adapter that is as told; the emulator gives them in turn."""
    random = Random(0)
    lines = answer.split("<header>")[1:]
    if kind == "lossy":  # any line may be lost
        kept = [[line for line in lines if random.random() > 0.1] for _ in range(40)]
        return ["".join(f"<header>{line}" for line in kept_lines) for kept_lines in kept]
    if kind == "lying":  # half of what it says is of no car
        noise = (
            "<writeln>7EC 1</writeln><writeln>ELECTRIC 00 GG</writeln><writeln>7EC 30</writeln>"
        )
        return [noise, answer, "<writeln>CAN ERROR</writeln>", answer + noise]
    return [answer]


def main(kind: str, port: int | None = None) -> None:
    """Serve until stdin ends."""
    emulator = Elm(batch_mode=True, net_port=port, net_interface="127.0.0.1" if port else None)
    emulator.ObdMessage["kona"] = scenario(kind)
    emulator.set_sorted_obd_msg("kona")
    place = emulator.get_pty() if port is None else f"tcp:127.0.0.1:{port}"
    with emulator:
        print(f"at {place}", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
