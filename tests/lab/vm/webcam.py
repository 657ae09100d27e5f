"""USB webcams that are not there, over USB/IP: the kernel's own uvcvideo binds to them. Standard library
only.

    webcam.py serve FOLDER...       a camera per folder, plugged in; ends with its input

What a folder holds is said in `tests.lab.vm.numbered`.

Written after the USB Video Class 1.0 (descriptors, controls, payload headers) and the kernel's
``Documentation/usb/usbip_protocol.rst``.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import sys
import threading
import time
from pathlib import Path

from tests.lab.vm.numbered import HEIGHT, RAW_BYTES, SMALL, WIDTH, Pictures

WHERE = "/tmp/webcams.sock"
VHCI = Path("/sys/devices/platform/vhci_hcd.0")
HZ = 10_000_000
"""Intervals are counted in 100 ns."""
MJPG, YUYV = 1, 2
INTERVALS = {MJPG: (HZ // 30, HZ // 15, HZ // 5), YUYV: (HZ // 5,)}
LARGE_FRAME, SMALL_FRAME = 1, 2
"""Sizes of MJPG, by their number in the descriptors; YUYV has the large one only."""
TERMINAL, PROCESSING, OUTPUT = 1, 2, 3
CLOCK_HZ = 48_000_000


class Control:
    """One control: its range and value."""

    def __init__(self, size: int, low: int, high: int, step: int, usual: int) -> None:
        self.size, self.low, self.high, self.step, self.usual = size, low, high, step, usual
        self.value = usual


def controls() -> dict[tuple[int, int], Control]:
    """By unit and selector: what a webcam wakes up with, its automatics on."""
    return {
        (TERMINAL, 2): Control(1, 1, 9, 9, 8),  # automatic exposure: a set of bits, 1 by hand, 8 automatic
        (TERMINAL, 3): Control(1, 0, 1, 1, 1),  # the rate may fall in the dark
        (TERMINAL, 4): Control(4, 1, 5000, 1, 156),  # exposure, 100 us
        (TERMINAL, 6): Control(2, 0, 250, 5, 0),  # focus
        (TERMINAL, 8): Control(1, 0, 1, 1, 1),  # automatic focus
        (PROCESSING, 2): Control(2, -64, 64, 1, 0),  # brightness
        (PROCESSING, 4): Control(2, 0, 100, 1, 0),  # gain
        (PROCESSING, 5): Control(1, 0, 2, 1, 0),  # power line
        (PROCESSING, 10): Control(2, 2800, 6500, 10, 4600),  # white balance, kelvin
        (PROCESSING, 11): Control(1, 0, 1, 1, 1),  # automatic white balance
    }


EXPOSURE = (TERMINAL, 4)
AUTO_EXPOSURE = (TERMINAL, 2)


def _descriptors(serial: int) -> tuple[bytes, bytes, dict[int, str]]:
    def u16(value: int) -> bytes:
        return struct.pack("<H", value)

    def frame(kind: int, intervals: tuple[int, ...], number: int = LARGE_FRAME) -> bytes:
        width, height = SMALL if number == SMALL_FRAME else (WIDTH, HEIGHT)
        raw_bytes = width * height * 2
        body = bytes((0x24, kind, number, 0)) + struct.pack("<HH", width, height)
        body += struct.pack("<III", raw_bytes * 8 * 5, raw_bytes * 8 * 30, raw_bytes)
        body += struct.pack("<IB", intervals[0], len(intervals))
        body += b"".join(struct.pack("<I", one) for one in intervals)
        return bytes((len(body) + 1,)) + body

    colour = bytes((6, 0x24, 13, 1, 1, 4))
    sizes = frame(7, INTERVALS[MJPG]) + frame(7, INTERVALS[MJPG], SMALL_FRAME)
    mjpg = bytes((11, 0x24, 6, MJPG, 2, 1, 1, 0, 0, 0, 0)) + sizes + colour
    yuy2 = b"YUY2" + bytes((0, 0, 0x10, 0, 0x80, 0, 0, 0xAA, 0, 0x38, 0x9B, 0x71))
    yuyv = (
        bytes((27, 0x24, 4, YUYV, 1)) + yuy2 + bytes((16, 1, 0, 0, 0, 0)) + frame(5, INTERVALS[YUYV]) + colour
    )
    header = bytes((15, 0x24, 1, 2)) + u16(15 + len(mjpg) + len(yuyv)) + bytes((0x81, 0, 3, 0, 0, 0, 1, 0, 0))
    streaming = header + mjpg + yuyv
    terminal = bytes((18, 0x24, 2, TERMINAL)) + u16(0x0201) + bytes(8) + bytes((3, 0x2E, 0x00, 0x02))
    processing = bytes((11, 0x24, 5, PROCESSING, TERMINAL, 0, 0, 2, 0x41, 0x16, 0))
    output = bytes((9, 0x24, 3, OUTPUT)) + u16(0x0101) + bytes((0, PROCESSING, 0))
    units = terminal + processing + output
    control = bytes((13, 0x24, 1)) + u16(0x0100) + u16(13 + len(units)) + struct.pack("<I", CLOCK_HZ)
    control += bytes((1, 1)) + units
    body = bytes((8, 11, 0, 2, 14, 3, 0, 2)) + bytes((9, 4, 0, 0, 0, 14, 1, 0, 2)) + control
    body += bytes((9, 4, 1, 0, 1, 14, 2, 0, 0)) + streaming + bytes((7, 5, 0x81, 2)) + u16(512) + bytes((0,))
    configuration = bytes((9, 2)) + u16(9 + len(body)) + bytes((2, 1, 0, 0x80, 250)) + body
    device = bytes((18, 1)) + u16(0x0200) + bytes((0xEF, 2, 1, 64))
    device += u16(0x1209) + u16(0xCA70) + u16(0x0100) + bytes((1, 2, 3, 1))
    return device, configuration, {1: "mikado lab", 2: "Stick Camera", 3: f"LAB{serial:04d}"}


class Webcam:
    """One camera; plugged in and pulled out any number of times, each time as it left the factory."""

    def __init__(self, number: int, folder: Path) -> None:
        self.number = number
        self.pictures = Pictures(folder)
        self.device, self.configuration, self.strings = _descriptors(number)
        self.news = threading.Condition()
        self.waiting: list[tuple[int, int]] = []
        self.plugged = False
        self.fault = ""
        self.sent = self.handed = self.told = 0
        self.begun: dict[int, float] = {}
        self.controls = controls()
        self.probe = bytearray(26)
        self._negotiate(MJPG, INTERVALS[MJPG][0])

    def plug(self) -> None:
        """As if somebody plugged it in."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        self.link = ours
        self.speaking = threading.Lock()
        self.waiting, self.plugged, self.controls = [], True, controls()
        self._negotiate(MJPG, INTERVALS[MJPG][0])
        for task in (self._answer, self._stream):
            threading.Thread(target=task, args=(ours,), daemon=True).start()
        (VHCI / "attach").write_text(f"{self.number} {theirs.fileno()} {0x10002 + self.number} 3")
        theirs.close()

    def unplug(self) -> None:
        """As if somebody pulled it out."""
        with self.news:
            self.plugged = False
            self.news.notify_all()
        (VHCI / "detach").write_text(str(self.number))

    # ---------------------------------------------------------------- requests of the host

    def _answer(self, link: socket.socket) -> None:
        try:
            while True:
                head = _exactly(link, 48)
                command, sequence, _, direction, endpoint = struct.unpack(">5I", head[:20])
                if command == 2:
                    self._unlink(link, sequence, struct.unpack(">I", head[20:24])[0])
                    continue
                length = struct.unpack(">i", head[24:28])[0]
                out = _exactly(link, length) if direction == 0 and length > 0 else b""
                if endpoint != 0:
                    with self.news:
                        self.waiting.append((sequence, length))
                        self.news.notify_all()
                    continue
                answer = self._control(head[40:48], out)
                if answer is None:
                    self._reply(link, sequence, -32, b"", 0)  # EPIPE: not understood
                elif direction == 0:
                    self._reply(link, sequence, 0, b"", len(out))
                else:
                    self._reply(link, sequence, 0, answer[:length], len(answer[:length]))
        except (ConnectionError, OSError):
            with self.news:
                if self.link is link:
                    self.plugged = False
                    self.news.notify_all()
        finally:
            link.close()

    def _unlink(self, link: socket.socket, sequence: int, other: int) -> None:
        # one critical section with the stream: an answer to a request taken back makes the host drop the
        # device
        with self.news:
            hit = any(one == other for one, _ in self.waiting)
            self.waiting = [one for one in self.waiting if one[0] != other]
            with self.speaking:
                link.sendall(struct.pack(">5Ii24x", 4, sequence, 0, 0, 0, -104 if hit else 0))

    def _reply(self, link: socket.socket, sequence: int, status: int, data: bytes, length: int) -> None:
        with self.speaking:
            link.sendall(struct.pack(">5I5i8x", 3, sequence, 0, 0, 0, status, length, 0, 0, 0) + data)

    def _control(self, setup: bytes, out: bytes) -> bytes | None:
        kind, request, value, index, _ = struct.unpack("<BBHHH", setup)
        if kind & 0x60 == 0:
            return self._standard(request, value)
        selector, unit, interface = value >> 8, index >> 8, index & 0xFF
        if interface == 1:
            return self._negotiation(selector, request, out)
        control = self.controls.get((unit, selector))
        if control is None:
            return None
        if request == 0x01:
            with self.news:
                control.value = int.from_bytes(out[: control.size], "little", signed=control.low < 0)
            return b""
        if request in (0x85, 0x86):
            return {0x85: struct.pack("<H", control.size), 0x86: b"\x03"}[request]
        told = {
            0x81: control.value,
            0x82: control.low,
            0x83: control.high,
            0x84: control.step,
            0x87: control.usual,
        }
        if request not in told:
            return None
        return told[request].to_bytes(control.size, "little", signed=control.low < 0)

    def _standard(self, request: int, value: int) -> bytes | None:
        if request == 6:
            kind, which = value >> 8, value & 0xFF
            if kind == 1:
                return self.device
            if kind == 2:
                return self.configuration
            if kind == 3 and which == 0:
                return bytes((4, 3, 9, 4))
            if kind == 3 and which in self.strings:
                text = self.strings[which].encode("utf-16le")
                return bytes((2 + len(text), 3)) + text
            return None
        return {0: b"\0\0", 8: b"\1", 10: b"\0"}.get(request, b"")

    def _negotiate(self, form: int, interval: int, frame: int = LARGE_FRAME) -> None:
        nearest = min(INTERVALS[form], key=lambda one: abs(one - interval))
        small = form == MJPG and frame == SMALL_FRAME
        self.form, self.interval, self.small = form, nearest, small
        most = SMALL[0] * SMALL[1] * 2 if small else RAW_BYTES
        frame = SMALL_FRAME if small else LARGE_FRAME
        self.probe = bytearray(
            struct.pack("<HBBIHHHHHII", 1, form, frame, nearest, 0, 0, 0, 0, 0, most, most + 12)
        )

    def _negotiation(self, selector: int, request: int, out: bytes) -> bytes | None:
        if selector not in (1, 2):
            return None
        if request == 0x01:
            form, interval = out[2], struct.unpack("<I", out[4:8])[0]
            with self.news:
                self._negotiate(form if form in INTERVALS else MJPG, interval or INTERVALS[MJPG][0], out[3])
            return b""
        return {0x86: b"\x03", 0x85: struct.pack("<H", 26)}.get(request, bytes(self.probe))

    # ---------------------------------------------------------------- pictures

    def _exposed(self) -> bytes:
        """The next picture, as it is now; notes when it was exposed."""
        fault = self.fault
        if fault != "stuck":
            self.sent += 1
        self.begun[self.sent] = time.monotonic()
        self.begun.pop(self.sent - 3000, None)
        if self.form == YUYV:
            return self.pictures.raw
        by_hand = self.controls[AUTO_EXPOSURE].value == 1
        exposure = self.controls[EXPOSURE].value if by_hand else self.controls[EXPOSURE].usual
        content = self.pictures.jpeg(exposure, self.sent, small=self.small)
        return content[: len(content) // 2] if fault == "short" else content

    def _stream(self, link: socket.socket) -> None:
        due = time.monotonic()
        toggle = 0
        while self._waited_for(link):
            due = max(due + self.interval / HZ, time.monotonic() - 0.2)
            time.sleep(max(0.0, due - time.monotonic()))
            if self.fault == "frozen":
                continue
            content = self._exposed()
            stamp = int(time.monotonic() * CLOCK_HZ) & 0xFFFFFFFF
            flags = 0x80 | 0x04 | 0x02 | toggle | (0x40 if self.fault == "spoilt" else 0)
            payload = bytes((12, flags)) + struct.pack("<IIH", stamp, stamp, 0) + content
            toggle ^= 1
            if len(payload) % 512 == 0:
                payload += b"\0"  # a short packet ends a payload
            if not self._hand_over(link, payload):
                return

    def _waited_for(self, link: socket.socket) -> bool:
        """Wait until the host asks for pictures; False when this camera was pulled out."""
        with self.news:
            while not self.waiting and self.plugged and self.link is link:
                self.news.wait(0.5)
            return self.plugged and self.link is link

    def _hand_over(self, link: socket.socket, payload: bytes) -> bool:
        ended = False
        while not ended:
            if not self._waited_for(link):
                return False
            with self.news:
                if not self.waiting:
                    continue
                sequence, length = self.waiting.pop(0)
                piece, payload = payload[:length], payload[length:]
                ended = len(piece) < length
                try:
                    self._reply(link, sequence, 0, piece, len(piece))
                except OSError:
                    return False
        self.handed += 1
        return True


def _exactly(link: socket.socket, count: int) -> bytes:
    got = b""
    while len(got) < count:
        piece = link.recv(count - len(got))
        if not piece:
            raise ConnectionError("closed")
        got += piece
    return got


def obey(cameras: list[Webcam], order: str, which: int) -> dict[str, object]:
    """``plug``, ``unplug``, ``state``, ``exposed``, or a fault: ``frozen``, ``stuck``, ``short``, ``spoilt``,
    ``none``.

    Told with each: when the last 3000 pictures were exposed; with ``exposed`` those since the last such order
    only, which costs less.
    """
    camera = cameras[which]
    at = time.monotonic()
    if order == "plug":
        camera.plug()
    elif order == "unplug":
        camera.unplug()
    elif order not in ("state", "exposed"):
        camera.fault = "" if order == "none" else order
    values = {f"{unit}.{selector}": control.value for (unit, selector), control in camera.controls.items()}
    begun = dict(camera.begun)
    if order == "exposed":
        begun = {number: at for number, at in begun.items() if number > camera.told}
        camera.told = max(begun, default=camera.told)
    return {
        "at": at,
        "sent": camera.sent,
        "handed": camera.handed,
        "plugged": camera.plugged,
        "controls": values,
        "begun": begun,
    }


def serve(folders: list[str]) -> None:
    """Plug all of them in and obey."""
    cameras = [Webcam(number, Path(folder)) for number, folder in enumerate(folders)]
    door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    Path(WHERE).unlink(missing_ok=True)
    door.bind(WHERE)
    door.listen()
    for camera in cameras:
        camera.plug()
    print("plugged in", flush=True)
    while True:
        visitor, _ = door.accept()
        with visitor, visitor.makefile("rw") as talk:
            order, which = talk.readline().split()
            talk.write(json.dumps(obey(cameras, order, int(which))) + "\n")


def tell(order: str, which: int = 0) -> dict[str, object]:
    """Give an order to the running cameras; their answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.connect(WHERE)
        with link.makefile("rw") as talk:
            talk.write(f"{order} {which}\n")
            talk.flush()
            answer = json.loads(talk.readline())
    assert isinstance(answer, dict)
    return answer


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        # the scheduler must not let the camera wait behind who looks at it
        os.nice(-10)
        serve(sys.argv[2:])
    else:
        print(json.dumps(tell(sys.argv[1], int(sys.argv[2]))))
