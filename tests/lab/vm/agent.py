"""Runs in the virtual machine: one command per line from the host, its outcome back. Standard library only.

A request is ``{"id": 3, "argv": [...], "timeout_s": 20}``, an answer
``{"id": 3, "code": 0, "out": "...", "err": "...", "took_s": 0.4}``; several commands may run at once.
"""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time

PORT = "/dev/virtio-ports/lab"
ENVIRONMENT = {
    "PYTHONPATH": "/opt/site:/lab/code",
    "OPENCV_LOG_LEVEL": "ERROR",
    "PYTHONDONTWRITEBYTECODE": "1",
}


def ran(argv: list[str], timeout_s: float) -> tuple[int, str, str]:
    """Exit code, what it printed, what it complained of; -1 when it was not done in time or did not start."""
    try:
        done = subprocess.run(
            argv,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            env={**os.environ, **ENVIRONMENT},
            check=False,
        )
    except subprocess.TimeoutExpired as late:
        # whatever was asked for, this exception holds bytes
        out, err = (
            said.decode(errors="replace") if isinstance(said, bytes) else ""
            for said in (late.stdout, late.stderr)
        )
        return -1, out, f"not done after {timeout_s} s\n{err}"
    except OSError as error:
        return -1, "", str(error)
    return done.returncode, done.stdout, done.stderr


def main() -> None:
    """Until the host closes the port."""
    port = os.open(PORT, os.O_RDWR)
    speaking = threading.Lock()

    def say(answer: dict[str, object]) -> None:
        line = json.dumps(answer).encode() + b"\n"
        with speaking:
            while line:
                line = line[os.write(port, line) :]

    def serve(request: dict[str, object]) -> None:
        began = time.monotonic()
        argv, timeout_s = request["argv"], request["timeout_s"]
        assert isinstance(argv, list)
        assert isinstance(timeout_s, int | float)
        code, out, err = ran(argv, float(timeout_s))
        took_s = time.monotonic() - began
        say({"id": request["id"], "code": code, "out": out, "err": err, "took_s": took_s})

    say({"id": 0, "code": 0, "out": "up", "err": "", "took_s": time.monotonic()})
    waiting = b""
    while True:
        got = os.read(port, 65536)
        if not got:
            return
        *lines, waiting = (waiting + got).split(b"\n")
        for line in lines:
            request = json.loads(line)
            if request["id"] == 0:
                return
            threading.Thread(target=serve, args=(request,), daemon=True).start()


if __name__ == "__main__":
    main()
