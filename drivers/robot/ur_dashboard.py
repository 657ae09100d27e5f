"""The controller's dashboard on port 29999: one line in, one line out. Every call ends in time.

The library's client, answered late, breaks its connection and still says it is connected; this one gives a
connection up at the first doubt. Source of the words: "Dashboard Server e-Series", Universal Robots.
"""

from __future__ import annotations

import re
import socket
from types import TracebackType
from typing import Final, Self

from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable, NotInRemote
from drivers.timing import Clock

PORT: Final = 29999
LINE_LIMIT: Final = 4096
ANSWER_S: Final = 1.0
_LOCAL: Final = "Remote Control mode"


class Dashboard:
    """One conversation: ``with Dashboard(...) as panel``."""

    def __init__(self, name: str, host: str, clock: Clock, answer_s: float = ANSWER_S) -> None:
        self._name = name
        self._host = host
        self._clock = clock
        self._answer_s = answer_s
        self._socket: socket.socket | None = None
        self._rest = b""

    def __enter__(self) -> Self:
        try:
            self._socket = socket.create_connection((self._host, PORT), timeout=self._answer_s)
            banner = self._line(self._clock.now() + self._answer_s)
        except TimeoutError as error:
            self.close()
            raise DeviceTimeout(self._name, f"dashboard {self._host}:{PORT} does not answer") from error
        except OSError as error:
            self.close()
            raise DeviceUnavailable(self._name, f"no dashboard at {self._host}:{PORT}: {error}") from error
        if "Dashboard Server" not in banner:
            self.close()
            raise DeviceUnavailable(
                self._name, f"{self._host}:{PORT} greets with {banner[:60]!r}: not the dashboard of a UR"
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Hang up; may come twice."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _line(self, until: float) -> str:
        if self._socket is None:
            raise ConnectionError("not connected")
        while b"\n" not in self._rest:
            left_s = until - self._clock.now()
            if left_s <= 0.0:
                raise TimeoutError("no line in time")
            self._socket.settimeout(left_s)
            data = self._socket.recv(LINE_LIMIT)
            if not data:
                raise ConnectionError("the controller hung up")
            self._rest += data
            if len(self._rest) > LINE_LIMIT:
                raise ConnectionError("a line without an end")
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode("utf-8", "replace").strip()

    def ask(self, line: str) -> str:
        """The answer to one line.

        Raises
        ------
        DeviceTimeout
            None in time.
        DeviceUnavailable
            The connection is lost.
        NotInRemote
            Not allowed while the arm is in local control.
        """
        try:
            if self._socket is None:
                raise ConnectionError("not connected")
            self._socket.settimeout(self._answer_s)
            self._socket.sendall(line.encode() + b"\n")
            answer = self._line(self._clock.now() + self._answer_s)
        except TimeoutError as error:
            self.close()  # or a late answer would be taken for the next one
            raise DeviceTimeout(
                self._name, f"dashboard: no answer to {line!r} within {self._answer_s:.1f} s"
            ) from error
        except OSError as error:
            self.close()
            raise DeviceUnavailable(self._name, f"dashboard lost: {error}") from error
        if _LOCAL in answer:
            raise NotInRemote(self._name, "in local control: switch it to remote control at its panel")
        return answer

    def _told(self, line: str, pattern: str) -> str:
        answer = self.ask(line)
        match = re.fullmatch(pattern, answer)
        if match is None:
            raise CommandRejected(self._name, f"dashboard: {line!r} was answered with {answer[:120]!r}")
        return match.group(1)

    def robot_mode(self) -> str:
        """``RUNNING``, ``POWER_OFF``, ..."""
        return self._told("robotmode", r"Robotmode: (\w+)")

    def safety_status(self) -> str:
        """``NORMAL``, ``PROTECTIVE_STOP``, ..."""
        return self._told("safetystatus", r"Safetystatus: (\w+)")

    def program_state(self) -> tuple[str, str]:
        """``STOPPED``, ``PLAYING`` or ``PAUSED``, and the program's name."""
        told = self._told("programState", r"((?:STOPPED|PLAYING|PAUSED).*)")
        state, _, program = told.partition(" ")
        return state, program.strip()

    def version(self) -> tuple[int, int, int]:
        """Of PolyScope."""
        told = self._told("PolyscopeVersion", r".*?(\d+\.\d+\.\d+).*")
        major, minor, bugfix = (int(part) for part in told.split("."))
        return major, minor, bugfix

    def in_remote(self) -> bool:
        """Whether the arm takes orders over the network."""
        return self._told("is in remote control", r"(true|false)") == "true"

    def robot_model(self) -> str:
        """``UR5``, ``UR10``, ..."""
        return self._told("get robot model", r"(\w+)")

    def stop(self) -> None:
        """Stop the program on the controller, and with it the arm."""
        self._told("stop", r"(Stopped)")

    def unlock(self) -> None:
        """Release a protective stop; refused until 5 s after it."""
        self._told("unlock protective stop", r"(Protective stop releasing)")

    def close_popups(self) -> None:
        """Close what the panel asks, so that it does not hold up what follows."""
        for line in ("close safety popup", "close popup"):
            self.ask(line)

    def power_on(self) -> None:
        """Power for the arm; look at `robot_mode` for whether it came."""
        self._told("power on", r"(Powering on)")

    def release_brakes(self) -> None:
        """The arm may move a little; look at `robot_mode` for whether it is ready."""
        self._told("brake release", r"(Brake releasing)")
