"""Requests of the fault port of the simulated UR controller: JSON objects, values checked when asked for."""

from __future__ import annotations

import json
from typing import TypeAlias

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"


class Refused(Exception):
    """The request is not understood; says what would be."""


class Request:
    """One request; every getter refuses what is missing or of another kind."""

    def __init__(self, values: dict[str, Json]) -> None:
        self._values = values

    @classmethod
    def of(cls, line: bytes) -> Request:
        """A line of JSON as a request; `Refused` if it is none."""
        try:
            values: Json = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise Refused(f"not JSON: {error}") from error
        if not isinstance(values, dict):
            raise Refused("not a JSON object")
        return cls(values)

    def has(self, key: str) -> bool:
        """Whether a value of that name came."""
        return key in self._values

    def text(self, key: str, *allowed: str) -> str:
        """A text, one of ``allowed`` if there are any."""
        value = self._values.get(key)
        if not isinstance(value, str) or (allowed and value not in allowed):
            raise Refused(f"{key!r} is {value!r}; it must be " + (" or ".join(allowed) or "a text"))
        return value

    def number(self, key: str, low: float, high: float) -> float:
        """A number between two others, both included."""
        value = self._values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise Refused(f"{key!r} is {value!r}; it must be a number from {low:g} to {high:g}")
        return float(value)

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self._values.get(key)
        if not isinstance(value, bool):
            raise Refused(f"{key!r} is {value!r}; it must be true or false")
        return value

    def items(self, key: str) -> list[Json]:
        """A list with something in it."""
        value = self._values.get(key)
        if not isinstance(value, list) or not value:
            raise Refused(f"{key!r} is {value!r}; it must be a list with something in it")
        return value

    def part(self, key: str) -> Request:
        """An object in the object."""
        value = self._values.get(key)
        if not isinstance(value, dict):
            raise Refused(f"{key!r} is {value!r}; it must be an object")
        return Request(value)
