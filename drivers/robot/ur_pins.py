"""The controller's digital pins, read once: for a look at what is wired to the arm. Switches nothing."""

from __future__ import annotations

import struct
from typing import Final

from drivers.errors import DeviceTimeout, DeviceUnavailable
from drivers.robot.rtde import Connection, Kind, RtdeError
from drivers.timing import Clock
from drivers.types import Pins

WITHIN_S: Final = 1.0
_WORDS: Final = ("actual_digital_input_bits", "actual_digital_output_bits")
_RATE_HZ: Final = 10.0


def read_pins(name: str, host: str, clock: Clock) -> Pins:
    """Inputs and outputs as they are now.

    Raises
    ------
    DeviceUnavailable, DeviceTimeout
        ``name`` could not be asked.
    """
    connection = Connection(clock.now)
    try:
        connection.open(host, WITHIN_S)
        recipe = connection.outputs(_WORDS, _RATE_HZ, WITHIN_S)
        if not recipe.usable:
            raise DeviceUnavailable(name, f"the controller at {host} does not tell its digital pins")
        connection.start(WITHIN_S)
        until = clock.now() + WITHIN_S
        while (left_s := until - clock.now()) > 0.0:
            for frame in connection.receive(left_s):
                if frame.kind == Kind.DATA:
                    inputs, outputs = recipe.unpack(frame.body).values()
                    assert isinstance(inputs, int)
                    assert isinstance(outputs, int)
                    return Pins(inputs=inputs, outputs=outputs)
        raise DeviceTimeout(name, f"no data of the controller at {host} within {WITHIN_S:g} s")
    except TimeoutError as error:
        raise DeviceTimeout(name, f"RTDE at {host}: {error}") from error
    except (OSError, RtdeError, struct.error) as error:
        raise DeviceUnavailable(name, f"RTDE at {host}: {error}") from error
    finally:
        connection.close()
