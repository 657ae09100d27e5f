"""UR's own RTDE client for Python against the simulated controller: a peer nobody here wrote.

It is not on the package index, and its source is not ours to carry. The test takes an installed ``rtde``
package, or the checkout of RTDE_Python_Client_Library that MIKADO_UR_RTDE_CLIENT names; without one it skips,
and says so.
"""

from __future__ import annotations

import importlib
import itertools
import os
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest

from tests.fakes.rtdewire import RtdeWire
from tests.fakes.urcontroller import UrController, ur_controller

WHERE = "MIKADO_UR_RTDE_CLIENT"


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """The client's module."""
    folder = os.environ.get(WHERE)
    if folder is not None:
        sys.path.insert(0, folder)
    try:
        yield importlib.import_module("rtde.rtde")
    except ImportError:
        pytest.skip(
            "UR'S OWN RTDE CLIENT WAS NOT TRIED: there is no package 'rtde'; "
            f"set {WHERE} to a checkout of RTDE_Python_Client_Library"
        )
    finally:
        if folder is not None:
            sys.path.remove(folder)


@pytest.fixture
def ur() -> Iterator[UrController]:
    with ur_controller("--polyscope", "5.12.3") as running:
        yield running


@pytest.fixture
def peer(client: Any, ur: UrController) -> Iterator[Any]:
    """A connected client."""
    made = client.RTDE(ur.host)
    made.connect()
    yield made
    made.disconnect()


def test_it_asks_for_the_version(peer: Any) -> None:
    assert peer.get_controller_version() == (5, 12, 3, 0)


def test_it_streams_at_125_hz(peer: Any) -> None:
    names, types = ["timestamp", "actual_q", "runtime_state"], ["DOUBLE", "VECTOR6D", "UINT32"]
    assert peer.send_output_setup(names, types, frequency=125)
    assert peer.send_start()
    states = [peer.receive() for _ in range(125)]
    stamps = [state.timestamp for state in states]
    assert {round(after - before, 6) for before, after in itertools.pairwise(stamps)} == {0.008}
    assert len(states[0].actual_q) == 6


def test_it_is_told_what_is_not_found(peer: Any) -> None:
    with pytest.raises(ValueError, match="NOT_FOUND"):
        peer.send_output_setup(["timestamp", "no_such_variable"])


def test_it_is_told_what_is_in_use_until_that_connection_ends(
    peer: Any, client: Any, ur: UrController
) -> None:
    assert peer.send_input_setup(["input_int_register_30"], ["INT32"]) is not None
    other = client.RTDE(ur.host)
    other.connect()
    with pytest.raises(ValueError, match="already in use"):
        other.send_input_setup(["input_int_register_30"])
    peer.disconnect()
    ur.wait(owned_inputs=0)
    assert other.send_input_setup(["input_int_register_30"]) is not None
    other.disconnect()


def test_what_it_sends_arrives(peer: Any, ur: UrController) -> None:
    values = peer.send_input_setup(["speed_slider_mask", "speed_slider_fraction"], ["UINT32", "DOUBLE"])
    assert peer.send_output_setup(["timestamp"])
    assert peer.send_start()
    values.speed_slider_mask, values.speed_slider_fraction = 1, 0.4
    assert peer.send(values)
    ur.wait(speed_slider=0.4)


def test_a_pause_stops_its_stream_and_nobody_elses(peer: Any, ur: UrController) -> None:
    assert peer.send_output_setup(["timestamp"], frequency=500)
    assert peer.send_start()
    with closing(RtdeWire(ur.host)) as other:
        peer.receive()
        assert peer.send_pause()
        ends_at = time.monotonic() + 0.2
        quiet = 0
        while time.monotonic() < ends_at:
            quiet += int(peer.has_data())
            other.timestamp()
        assert quiet == 0
    assert peer.send_start()
    assert peer.receive().timestamp > 0.0
