"""What a person reads when a YAML file is wrong: one line with file, line and key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from cell import yamlfile
from cell.errors import ConfigError
from drivers.settings import Settings


class Cat(Settings):
    animal: Literal["cat"]
    lives: int


class Dog(Settings):
    animal: Literal["dog"]
    bark: str


class Farm(Settings):
    name: str
    size_m: float
    pet: Annotated[Cat | Dog, Field(discriminator="animal")]
    fields: tuple[int, ...] = ()


GOOD = "name: hill\nsize_m: 2.5\npet:\n  animal: cat\n  lives: 9\n"


def refused(tmp_path: Path, text: str | bytes) -> ConfigError:
    path = tmp_path / "farm.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as caught:
        yamlfile.load(path, Farm)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return caught.value


def test_a_good_file_becomes_its_model(tmp_path: Path) -> None:
    path = tmp_path / "farm.yaml"
    path.write_text(GOOD)
    farm = yamlfile.load(path, Farm)
    assert (farm.name, farm.size_m, farm.pet) == ("hill", 2.5, Cat(animal="cat", lives=9))


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (GOOD + "colour: red\n", 6, "colour: unknown key"),
        (GOOD.replace("lives: 9", "lives: 9\n  tail: 1"), 6, "pet.tail: unknown key"),
        (GOOD.replace("lives: 9", "lives: many"), 5, "pet.lives: Input should be a valid integer"),
        (GOOD.replace("lives: 9", "lives: many"), 5, "found 'many'"),
        (GOOD.replace("2.5", "wide"), 2, "size_m: Input should be a valid number"),
        (GOOD.replace("2.5", ".nan"), 2, "size_m: Input should be a finite number, found nan"),
        (GOOD.replace("2.5", ".inf"), 2, "size_m: Input should be a finite number, found inf"),
        (GOOD.replace("name: hill\n", ""), 1, "name: is missing"),
        (GOOD.replace("  lives: 9\n", ""), 3, "pet.lives: is missing"),
        (GOOD + "fields: [1, 2, x]\n", 6, "fields.2: Input should be a valid integer"),
        (GOOD + "fields:\n- 1\n- x\n", 8, "fields.1: Input should be a valid integer"),
        (GOOD.replace("animal: cat", "animal: cow"), 3, "pet: Input tag 'cow'"),
        (GOOD.replace("animal: cat", "animal: cow"), 3, "expected tags: 'cat', 'dog'"),
        (GOOD.replace("  animal: cat\n", ""), 3, "pet: Unable to extract tag using discriminator 'animal'"),
        (GOOD + "name: dale\n", 6, "key 'name' is given twice"),
        (GOOD + "  lives: 8\n", 6, "key 'lives' is given twice"),
    ],
)
def test_a_wrong_value_names_line_and_key(tmp_path: Path, text: str, line: int, said: str) -> None:
    error = refused(tmp_path, text)
    assert error.line == line
    assert said in error.detail


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("name: [1, 2\n", 2, "not readable as YAML: expected ',' or ']'"),
        ("name: a: b\n", 1, "not readable as YAML: mapping values are not allowed here"),
        ("name: hill\n\tsize_m: 1\n", 2, "not readable as YAML: found character '\\t'"),
        ("name: *other\n", 1, "found undefined alias 'other'"),
        ("name: hill\n---\nname: dale\n", 2, "but found another document"),
        ("- name\n", 1, "a mapping of keys is expected, found list"),
        ("hill\n", 1, "a mapping of keys is expected, found str"),
        ("", 1, "the file is empty"),
        ("# only a comment\n", 1, "the file is empty"),
        ("name: 2026-99-99\n", 1, "'2026-99-99' cannot be read: month must be in 1..12"),
        ("name: hill\nsize_m: !!int many\n", 2, "'many' cannot be read"),
        ("name: hill\n? [a, b]\n: 1\n", 2, "a key must be a word"),
        ("name: hill\0\n", None, "special characters are not allowed"),
        (b"name: \xff\xfe\n", None, "it is not UTF-8 text"),
    ],
)
def test_what_is_no_yaml_is_said_in_one_line(
    tmp_path: Path, text: str | bytes, line: int | None, said: str
) -> None:
    error = refused(tmp_path, text)
    assert error.line == line
    assert said in error.detail


def test_every_mistake_is_listed_with_its_own_line(tmp_path: Path) -> None:
    error = refused(tmp_path, GOOD.replace("9", "many").replace("2.5", "wide") + "colour: red\n")
    assert error.line == 2
    assert error.detail.startswith("size_m: ")
    assert "; line 5: pet.lives: " in error.detail
    assert "; line 6: colour: unknown key" in error.detail


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read: No such file"):
        yamlfile.load(tmp_path / "nowhere.yaml", Farm)


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        yamlfile.load(tmp_path, Farm)
