"""One value of a YAML file changed where it stands: comments, order and everything else stay as they were."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from cell.errors import ConfigError


def replaced(path: Path, section: str, values: Mapping[str, str]) -> str:
    """The text of a file with keys of a section set to new text; a key that is not there is added.

    Raises
    ------
    ConfigError
        Not readable, no such section, or a section in which nothing can be placed.
    """
    try:
        text = path.read_text(encoding="utf-8")
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(path, None, f"cannot be read: {error}") from error
    node = None
    if isinstance(root, yaml.MappingNode):
        node = next((value for key, value in root.value if key.value == section), None)
    if node is None:
        body = "".join(f"  {key}: {value}\n" for key, value in values.items())
        return text.rstrip("\n") + f"\n{section}:\n{body}"
    if not isinstance(node, yaml.MappingNode) or not node.value:
        raise ConfigError(path, node.start_mark.line + 1, f"{section}: a mapping of keys is expected")
    changes: list[tuple[int, int, str]] = []
    for key, value in values.items():
        old = next((v for k, v in node.value if k.value == key), None)
        if old is not None:
            changes.append((old.start_mark.index, old.end_mark.index, value))
            continue
        first = node.value[0][0].start_mark
        added = f"{key}: {value}, " if node.flow_style else f"{key}: {value}\n{' ' * first.column}"
        changes.append((first.index, first.index, added))
    for start, end, new in sorted(changes, reverse=True):
        text = text[:start] + new + text[end:]
    return text
