"""A GigE Vision camera that sends lost packets again when it is asked to, a process of its own: the fake
camera of viva-genicam, which shares no code with Aravis. Some packets it keeps back at first.

    python -m tests.lab.gige_resend_camera --address 10.77.1.2 --keep-back 20
"""

from __future__ import annotations

import argparse
import json
import signal
import sys

from viva_genicam.testing import FakeGigeCamera

FIRST_BLOCK = 5
PACKET = 3


def main() -> None:
    """Serve until standard input closes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--address", required=True)
    parser.add_argument("--keep-back", type=int, required=True, help="of so many frames a packet each")
    wanted = parser.parse_args()
    kept = [(FIRST_BLOCK + i, PACKET) for i in range(wanted.keep_back)]
    camera = FakeGigeCamera(640, 480, 20, wanted.address, packet_resend=True, drop_packets=kept)
    camera.start()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    print(json.dumps({"event": "listening", "address": wanted.address}), flush=True)
    sys.stdin.buffer.read()
    camera.stop()


if __name__ == "__main__":
    main()
