"""Which GigE Vision cameras answer on the networks of this machine; opens none of them."""

from __future__ import annotations

from drivers.camera import aravis
from drivers.types import FoundCamera


def found() -> tuple[FoundCamera, ...]:
    """Every camera that answers within a second, by serial number.

    Raises
    ------
    DeviceUnavailable
        The library is not there; says what to install.
    """
    library = aravis.load("cameras")
    answering = sorted(library.discover(), key=lambda one: (one.serial, one.device))
    return tuple(
        FoundCamera(
            driver="gige",
            key="serial" if one.serial else "address",
            device=one.serial or one.address,
            also=(f"address: {one.address}",) if one.serial else (),
            model=" ".join(word for word in (one.vendor, one.model) if word),
        )
        for one in answering
    )
