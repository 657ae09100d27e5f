"""YAML with line numbers: every error of a file names file, line and key."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from cell.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses a key given twice (YAML would silently take the last), and says where."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:
        try:
            return super().construct_object(node, deep=deep)
        except ValueError as error:  # a date that is none, a tag that does not fit
            raise yaml.MarkedYAMLError(
                problem=f"{node.value!r} cannot be read: {error}", problem_mark=node.start_mark
            ) from error

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, object]:
        seen: set[object] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise yaml.MarkedYAMLError(
                    problem="a key must be a word, not a list or a mapping", problem_mark=key_node.start_mark
                )
            if key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key!r} is given twice", problem_mark=key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


def load(path: Path, model: type[Model]) -> Model:
    """Read a YAML file into a pydantic model.

    Raises
    ------
    ConfigError
        File missing or no YAML; unknown key, missing key or wrong value: with line and key.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError(path, None, f"cannot be read: {reason}") from error
    try:
        root = yaml.compose(text, Loader=_Loader)
        data = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise ConfigError(path, line, f"not readable as YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        # a character that YAML forbids; its message has several lines
        raise ConfigError(path, None, f"not readable as YAML: {' '.join(str(error).split())}") from error
    if data is None:
        raise ConfigError(path, 1, "the file is empty; a mapping of keys is expected")
    if not isinstance(data, dict):
        raise ConfigError(path, 1, f"a mapping of keys is expected, found {type(data).__name__}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise _explain(path, root, error) from error


def _explain(path: Path, root: yaml.Node | None, error: ValidationError) -> ConfigError:
    problems = []
    first_line: int | None = None
    for item in error.errors(include_url=False):
        keys, line = _locate(root, item["loc"])
        first_line = line if first_line is None else first_line
        where = ".".join(keys) if keys else "(file)"
        match item["type"]:
            case "extra_forbidden":
                said = "unknown key"
            case "missing":
                said = "is missing"
            case "union_tag_invalid" | "union_tag_not_found":
                said = item["msg"]
            case _:
                value = item.get("input")
                shown = "" if isinstance(value, dict | list) else f", found {value!r}"
                said = f"{item['msg'].removeprefix('Value error, ')}{shown}"
        problems.append(f"{where}: {said}" if line in (None, first_line) else f"line {line}: {where}: {said}")
    return ConfigError(path, first_line, "; ".join(problems))


def _locate(root: yaml.Node | None, loc: Sequence[int | str]) -> tuple[list[str], int | None]:
    """The keys of a pydantic location that stand in the file (tags of unions do not), and the line."""
    node, keys = root, []
    line = None if root is None else root.start_mark.line + 1
    for part in loc:
        if isinstance(node, yaml.MappingNode):
            for key_node, value_node in node.value:
                if key_node.value == str(part):
                    node, line = value_node, key_node.start_mark.line + 1
                    keys.append(str(part))
                    break
            else:
                if part == loc[-1]:
                    keys.append(str(part))
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line + 1
            keys.append(str(part))
        elif part == loc[-1] and isinstance(part, int):
            keys.append(str(part))
    return keys, line
