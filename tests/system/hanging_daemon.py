"""The daemon with one worker that will hang: ``hanging_daemon.py WORKER FILE CONFIG``.

As soon as FILE exists, the detector (WORKER ``cell``) or the PLC driver (``plc``) is called and never comes
back. Limits are a second instead of several, so that a test need not wait for them.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from cell import cycle, daemon, logs  # noqa: E402 - the checkout has to be found first
from drivers.plc.modbus import ModbusPlc  # noqa: E402
from vision.locate import locate  # noqa: E402

Given = ParamSpec("Given")
Got = TypeVar("Got")


def hanging(call: Callable[Given, Got], once: Path) -> Callable[Given, Got]:
    """The same call until the file exists, then one without an end."""

    def wrapped(*args: Given.args, **kwargs: Given.kwargs) -> Got:
        if once.exists():
            threading.Event().wait()
        return call(*args, **kwargs)

    return wrapped


def main(worker: str, once: Path, config: Path) -> int:
    logs.setup(as_json=True)
    daemon._CELL_LIMIT_S = daemon._PLC_LIMIT_S = 1.0  # type: ignore[misc]  # final in the product
    if worker == "cell":
        cycle.locate = hanging(locate, once)  # type: ignore[attr-defined]  # imported there, not its own
    else:
        ModbusPlc.exchange = hanging(ModbusPlc.exchange, once)  # type: ignore[method-assign]
    return daemon.run(config)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])))
