"""A virtual machine with two webcams plugged in that see a rendered pile, and the project's code in it."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.lab.vm import scenery
from tests.lab.vm.machine import ROOT, Machine

CODE: Final = "/lab/code"
_INSIDE: Final = f"{CODE}/tests/lab/vm"
_SERVE_S: Final = 24 * 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Webcams:
    """The running machine, what its cameras see, and what the driver said in it."""

    machine: Machine
    scene: scenery.Scenery
    shared: Path

    def work(self, *tasks: str, timeout_s: float) -> None:
        """Run tasks of ``inside.py`` in the machine; `told` has what came of each."""
        self.machine.must("python3", f"{_INSIDE}/inside.py", "/lab/out", *tasks, timeout_s=timeout_s)

    def soak(self, seconds: float, timeout_s: float) -> dict[str, object]:
        """Run ``soak.py`` in the machine; what came of it."""
        command = ("python3", f"{_INSIDE}/soak.py", "/lab/out", f"{seconds:g}")
        self.machine.must(*command, timeout_s=timeout_s)
        return self.told("soak")

    def told(self, task: str) -> dict[str, object]:
        """What came of one task."""
        answer = json.loads((self.shared / "out" / f"{task}.json").read_text())
        assert isinstance(answer, dict)
        return answer


@contextmanager
def plugged_in(shared: Path) -> Iterator[Webcams]:
    """Start the machine and plug the cameras in; ``shared`` is an empty folder.

    Raises
    ------
    CannotStart
        There can be no such machine here.
    """
    # compiled files come along where they fit: compiling is slow inside
    for part in ("drivers", "tests"):
        shutil.copytree(ROOT / part, shared / "code" / part)
    shutil.copy(ROOT / "pyproject.toml", shared / "code")
    (shared / "out").mkdir()
    scene = scenery.make(shared / "scene")
    machine = Machine(shared)
    machine.start()
    serving = threading.Thread(target=_serve, args=(machine,), name="lab-webcams")
    try:
        machine.must("sh", "-c", "modprobe vhci-hcd && modprobe uvcvideo")
        serving.start()
        machine.must(
            "sh",
            "-c",
            "for try in $(seq 300); do [ -e /dev/v4l/by-path/*usb-0:2:1.0-video-index0 ] && exit 0; "
            "sleep 0.1; done; dmesg | tail -5; exit 1",
        )
        yield Webcams(machine=machine, scene=scene, shared=shared)
    finally:
        machine.end()
        if serving.ident is not None:
            serving.join(10.0)


def _serve(machine: Machine) -> None:
    command = ("python3", f"{_INSIDE}/webcam.py", "serve", "/lab/scene/left", "/lab/scene/right")
    try:
        machine.run(*command, timeout_s=_SERVE_S)
    except AssertionError:
        return  # the machine ended, and the cameras with it
