"""Do ``cell``, ``drivers`` and ``vision`` come from one installation? The three are common words.

A second distribution with a package of the same name overwrites ours, or hides it, without a word from the
installer; what then runs is half of each.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Final

PACKAGES: Final = ("cell", "drivers", "vision")
DISTRIBUTION: Final = "mikado-cell"


class ForeignPackage(Exception):
    """A package of ours is missing, somebody else's, or from another installation."""


def check() -> None:
    """Raise `ForeignPackage` unless all three are ours and lie in one folder.

    Loads the packages themselves and none of their modules.
    """
    folders = {name: _folder(name) for name in PACKAGES}
    home = folders["cell"].parent
    for name, folder in folders.items():
        if folder.parent != home:
            raise ForeignPackage(
                f"{name} comes from {folder.parent}, cell from {home}: two installations are mixed; "
                f"{_WAY_OUT}"
            )


_WAY_OUT: Final = f"install {DISTRIBUTION} anew, in an environment of its own"


def _folder(name: str) -> Path:
    try:
        package: ModuleType = import_module(name)
    except ImportError as error:
        raise ForeignPackage(f"package {name} cannot be imported ({error}); {_WAY_OUT}") from error
    # a folder that merely has the name is a package without a file
    where = "nowhere" if package.__file__ is None else str(Path(package.__file__).parent)
    if package.__file__ is None or vars(package).get("DISTRIBUTION") != DISTRIBUTION:
        raise ForeignPackage(
            f"package {name} ({where}) is not part of {DISTRIBUTION}: another distribution has put its own "
            f"there; {_WAY_OUT}"
        )
    return Path(package.__file__).resolve().parent
