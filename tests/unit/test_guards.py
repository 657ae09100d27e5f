"""The rules of `tests/conftest.py` really fail the tests that break them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

CONFTEST = Path(__file__).parents[1] / "conftest.py"

BREAKERS = """
import contextlib
import socket
import threading


def test_leaves_a_thread():
    threading.Thread(target=threading.Event().wait, args=(30,), name="stray", daemon=True).start()


def test_connects_to_another_host_and_hides_it():
    with contextlib.suppress(OSError), socket.socket() as s:
        s.settimeout(0.01)
        s.connect(("192.0.2.1", 9))


def test_sends_to_another_host_and_hides_it():
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.sendto(b"x", ("192.0.2.1", 9))


def test_looks_up_a_name_by_connecting():
    with contextlib.suppress(OSError), socket.socket() as s:
        s.connect(("example.org", 9))


def test_talks_to_itself():
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()):
        pass
"""


def test_a_stray_thread_and_a_foreign_host_fail_their_tests(tmp_path: Path) -> None:
    shutil.copy(CONFTEST, tmp_path)
    (tmp_path / "test_breakers.py").write_text(BREAKERS)

    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-rA", "-p", "no:cacheprovider", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        cwd=tmp_path,
    )

    assert "threads left running: stray" in done.stdout
    assert done.stdout.count("a test reached out to ('192.0.2.1', 9)") >= 2
    assert "a test reached out to ('example.org', 9)" in done.stdout
    assert "PASSED test_breakers.py::test_talks_to_itself" in done.stdout
    errors = {line.split("::")[1].split()[0] for line in done.stdout.splitlines() if line.startswith("ERROR")}
    assert errors == {
        "test_leaves_a_thread",
        "test_connects_to_another_host_and_hides_it",
        "test_sends_to_another_host_and_hides_it",
        "test_looks_up_a_name_by_connecting",
    }
