"""The virtual machine, seen from the host: made ready once, started, asked to run commands, ended.

What it takes (qemu, mmdebstrap, ...) is installed by ``tests/lab/setup.sh``; the image is kept in
``$XDG_CACHE_HOME/mikado-lab`` and made anew when its script or a library changes. Emulation is in software:
times inside are several times those of a real machine.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
TOOLS = ("qemu-system-x86_64", "mmdebstrap", "busybox", "depmod", "cpio", "mke2fs")
WHEELS = (
    "numpy",
    "opencv-python-headless",
    "pydantic",
    "pydantic-core",
    "typing-extensions",
    "annotated-types",
    "typing-inspection",
    "structlog",
    "pytest",
    "pluggy",
    "iniconfig",
    "packaging",
    "pygments",
    "pyyaml",
)
IMAGE_S = 600.0
BOOT_S = 240.0


class CannotStart(Exception):
    """The machine cannot be had here; says why and what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ran:
    """What became of a command."""

    code: int
    out: str
    err: str
    took_s: float


def cache() -> Path:
    """Where images are kept: outside the tree."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "mikado-lab"


def image() -> Path:
    """The folder with kernel and disk; made if it is not there.

    Raises
    ------
    CannotStart
        A tool is missing, or making the image failed.
    """
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    missing = [tool for tool in TOOLS if shutil.which(tool, path=path) is None]
    if missing:
        raise CannotStart(f"{', '.join(missing)} not installed; as root: tests/lab/setup.sh")
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        raise CannotStart(f"made for Linux on x86_64, this is {sys.platform} on {os.uname().machine}")
    script = HERE / "image.sh"
    wheels = [f"{name}=={importlib.metadata.version(name)}" for name in WHEELS]
    key = hashlib.sha256(script.read_bytes() + " ".join(wheels).encode()).hexdigest()[:12]
    folder = cache() / f"vm-{key}"
    if (folder / "disk.img").is_file():
        return folder
    if os.geteuid() != 0:
        raise CannotStart("its image is not made yet, which takes root; run this test once as root")
    environment = {**os.environ, "PYTHON": sys.executable, "PATH": path}
    try:
        made = subprocess.run(
            [str(script), str(folder), *wheels],
            env=environment,
            capture_output=True,
            text=True,
            timeout=IMAGE_S,
            check=False,
        )
    except subprocess.TimeoutExpired as late:
        raise CannotStart(f"image.sh was not done after {IMAGE_S:.0f} s") from late
    if made.returncode != 0:
        raise CannotStart(f"image.sh failed ({made.returncode}): {made.stderr[-800:]}")
    return folder


class Machine:
    """One running machine. ``shared`` is ``/lab`` inside."""

    def __init__(self, shared: Path) -> None:
        self.shared = shared
        self._process: subprocess.Popen[bytes] | None = None
        self._link: socket.socket | None = None
        self._reader: threading.Thread | None = None
        self._answers: dict[int, Ran] = {}
        self._news = threading.Condition()
        self._ended = False
        self._number = 0

    def start(self) -> None:
        """Boot and wait for the agent.

        Raises
        ------
        CannotStart
            No image, or it did not come up; with the end of its console.
        """
        folder = image()
        shutil.copy(HERE / "agent.py", self.shared / "agent.py")
        link = self.shared / "agent.sock"
        console = self.shared / "console.log"
        with console.open("wb") as log:
            self._process = subprocess.Popen(
                [
                    "qemu-system-x86_64",
                    *("-accel", "tcg,thread=multi,tb-size=512", "-cpu", "Nehalem", "-smp", "2", "-m", "1536"),
                    *("-nodefaults", "-no-reboot", "-display", "none", "-serial", "stdio"),
                    *("-kernel", str(folder / "vmlinuz"), "-initrd", str(folder / "initrd.gz")),
                    "-drive",
                    f"if=none,id=disk,file={folder / 'disk.img'},format=raw,snapshot=on",
                    *("-device", "virtio-blk-pci,drive=disk"),
                    *("-virtfs", f"local,path={self.shared},mount_tag=lab,security_model=none"),
                    *("-device", "virtio-serial-pci"),
                    *("-chardev", f"socket,id=agent,path={link},server=on,wait=off"),
                    *("-device", "virtserialport,chardev=agent,name=lab"),
                    "-append",
                    "console=ttyS0 quiet panic=-1 mitigations=off usbcore.autosuspend=-1",
                ],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self._connect(link)
        ends_at = time.monotonic() + BOOT_S
        with self._news:
            while 0 not in self._answers:
                if self._ended or not self._news.wait(max(0.0, ends_at - time.monotonic())):
                    break
        if 0 not in self._answers:
            tail = console.read_bytes()[-800:].decode(errors="replace")
            self.end()
            raise CannotStart(f"the virtual machine did not come up within {BOOT_S:.0f} s: {tail}")

    def run(self, *argv: str, timeout_s: float = 60.0) -> Ran:
        """Run a command inside; blocks. May be called from several threads at once."""
        with self._news:
            self._number += 1
            number = self._number
        request = {"id": number, "argv": list(argv), "timeout_s": timeout_s}
        self._send(request)
        ends_at = time.monotonic() + timeout_s + 10.0
        with self._news:
            while number not in self._answers:
                if self._ended:
                    raise AssertionError(f"the virtual machine ended during {argv}")
                if not self._news.wait(max(0.0, ends_at - time.monotonic())):
                    raise AssertionError(
                        f"no answer of the virtual machine to {argv} in {timeout_s + 10:.0f} s"
                    )
            return self._answers.pop(number)

    def must(self, *argv: str, timeout_s: float = 60.0) -> str:
        """As `run`; what it printed. Fails the test when the command failed."""
        ran = self.run(*argv, timeout_s=timeout_s)
        assert ran.code == 0, f"{' '.join(argv)}: {ran.code}\n{ran.out}\n{ran.err}"
        return ran.out

    def end(self) -> None:
        """Ask it to go, then end it."""
        if self._process is None:
            return
        if self._link is not None and not self._ended:
            try:
                self._send({"id": 0})
            except OSError:  # it is gone already
                self._ended = True
        try:
            self._process.wait(8.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._link is not None:
            self._link.close()
        if self._reader is not None:
            self._reader.join(5.0)
        self._process = self._link = self._reader = None

    def _connect(self, path: Path) -> None:
        assert self._process is not None
        ends_at = time.monotonic() + 20.0
        link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        while True:
            try:
                link.connect(str(path))
                break
            except OSError as error:
                if self._process.poll() is not None or time.monotonic() > ends_at:
                    link.close()
                    said = (self.shared / "console.log").read_bytes()[-800:].decode(errors="replace")
                    self.end()
                    raise CannotStart(f"qemu does not start: {said}") from error
                time.sleep(0.05)
        self._link = link
        self._reader = threading.Thread(target=self._read, args=(link,), name="vm-agent", daemon=True)
        self._reader.start()

    def _send(self, request: dict[str, object]) -> None:
        assert self._link is not None, "not started"
        self._link.sendall(json.dumps(request).encode() + b"\n")

    def _read(self, link: socket.socket) -> None:
        waiting = b""
        while True:
            try:
                got = link.recv(65536)
            except OSError:
                got = b""
            if not got:
                break
            *lines, waiting = (waiting + got).split(b"\n")
            for line in lines:
                said = json.loads(line)
                ran = Ran(code=said["code"], out=said["out"], err=said["err"], took_s=said["took_s"])
                with self._news:
                    self._answers[said["id"]] = ran
                    self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()
