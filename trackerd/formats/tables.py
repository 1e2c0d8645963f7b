"""TOML files as nested tables, and tables checked against models. Errors are collected, so that one look shows them all."""

import json
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from trackerd.contract.errors import ConfigError
from trackerd.formats.rules import explain, line

Tables = dict[str, Any]
Model = TypeVar("Model", bound=BaseModel)


@dataclass(slots=True)
class Problems:
    """The errors found so far in one file, and the values that came from the command line instead of the file."""

    file: str
    lines: list[str] = field(default_factory=list)
    overridden: dict[tuple[str, ...], str] = field(default_factory=dict)  # path of a key -> its text as given

    def add(self, table: Sequence[str], key: str | None, value: Any, rule: str) -> None:
        self._add(line(self.file, table, key, value, rule))

    def check(self, model: type[Model], raw: Mapping[str, Any], table: Sequence[str] = ()) -> Model | None:
        """The model of one table, or None after its errors were added.

        Types are strict, as JSON has them: a number in quotes is text, and `true` is not 1.
        """
        try:
            return _strict(model, raw)
        except ValidationError as err:
            found = err.errors(include_url=False)
        texts = [f["loc"] for f in found if f["type"] == "string_type" and self._key(table, f["loc"]) in self.overridden]
        if texts:  # `--set camera.left.serial=24587345` is text, though it reads as a number
            return self.check(model, self._with_texts(raw, table, texts), table)
        for one in found:
            self._add(explain(self.file, table, model, raw, one))
        return None

    def raise_any(self) -> None:
        if self.lines:
            raise ConfigError("\n".join(self.lines))

    def _add(self, text: str) -> None:
        text = " ".join(text.splitlines())  # a name in quotes may hold a line's end
        if text not in self.lines:
            self.lines.append(text)

    def _key(self, table: Sequence[str], path: Sequence[str | int]) -> tuple[str, ...]:
        return (*table, *map(str, path))

    def _with_texts(self, raw: Mapping[str, Any], table: Sequence[str], paths: Sequence[tuple[str | int, ...]]) -> Tables:
        copy: Tables = json.loads(_json(raw))
        for path in paths:
            put(copy, [str(step) for step in path], self.overridden[self._key(table, path)])
        return copy


def read_tables(path: Path) -> Tables:
    """Raises ConfigError for a file that is missing, unreadable, not UTF-8, or not TOML (with line and column)."""
    try:
        return tomllib.loads(path.read_bytes().decode())
    except FileNotFoundError:
        raise ConfigError(f"{path.name}: no such file: {path.absolute()}") from None
    except OSError as err:
        raise ConfigError(f"{path.name}: cannot be read: {err.strerror} ({path.absolute()})") from None
    except UnicodeDecodeError as err:
        raise ConfigError(f"{path.name}: byte {err.start} is not UTF-8: save the file as UTF-8 text") from None
    except tomllib.TOMLDecodeError as err:
        raise ConfigError(f"{path.name} {_syntax(str(err))}") from None
    except (RecursionError, ValueError):  # brackets without end, a number of thousands of digits
        raise ConfigError(f"{path.name}: is no configuration: nested too deeply, or a number too long") from None


def put(tables: Tables, path: Sequence[str], value: Any) -> None:
    """Set one key, making the tables on the way. Raises KeyError where a plain value is in the way."""
    *names, key = path
    for name in names:
        tables = tables.setdefault(name, {})
        if not isinstance(tables, dict):
            raise KeyError(name)
    tables[key] = value


def override(tables: Tables, text: str) -> tuple[tuple[str, ...], str]:
    """Lay `table.key=value` over the tables; returns its path and the value's text. The value is TOML, else plain text.

    Raises ConfigError.
    """
    name, equals, value_text = text.partition("=")
    path = _path(name) if equals else None
    if path is None:
        raise ConfigError(f"--set {text}: must have the form table.key=value")
    try:
        put(tables, path, _value(value_text.strip()))
    except KeyError as err:
        raise ConfigError(f"--set {text}: {err.args[0]} is no table") from None
    return path, value_text.strip()


def subtable(problems: Problems, tables: Mapping[str, Any], name: str) -> Tables:
    """A table of the file; empty where it is missing or, with an error, where it is no table."""
    found = tables.get(name, {})
    if isinstance(found, dict):
        return found
    problems.add((), name, found, f"must be a table: [{name}]")
    return {}


def resolved(model: Model, base: Path, problems: Problems, table: Sequence[str]) -> Model:
    """The model with every relative path taken from `base`; a path that was configured must exist."""
    changed: dict[str, Any] = {}
    for name, value in model:
        if isinstance(value, BaseModel):
            changed[name] = resolved(value, base, problems, (*table, name))
        elif isinstance(value, Path):
            changed[name] = located(base, value)
            if name in model.model_fields_set and not changed[name].exists():
                problems.add(table, name, str(value), f"no such file or folder: {changed[name]}")
    return model.model_copy(update=changed)


def located(base: Path, value: Path | str) -> Path:
    """A path as it is written in a file of the folder `base`, absolute and without '..'; the disk is not asked."""
    return Path(os.path.normpath(base / value))


def _strict(model: type[Model], raw: Mapping[str, Any]) -> Model:
    return model.model_validate_json(_json(raw), strict=True)


def _json(raw: Mapping[str, Any]) -> str:
    return json.dumps(raw, default=str)  # dates are the only TOML values that JSON lacks


def _path(name: str) -> tuple[str, ...] | None:
    try:
        tables: Any = tomllib.loads(f"{name} = 0")
    except tomllib.TOMLDecodeError:
        return None
    path: list[str] = []
    while isinstance(tables, dict):
        (key, tables), *more = tables.items()
        if more:
            return None
        path.append(key)
    return tuple(path)


def _value(text: str) -> Any:
    try:
        found = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return found["value"] if len(found) == 1 else text


def _syntax(message: str) -> str:
    """tomllib's message with its place in front and its two riddles in plain words."""
    place = re.search(r" \(at (.*)\)$", message)
    where, what = (place[1], message[: place.start()]) if place else ("", message)
    if twice := re.fullmatch(r"Cannot declare \((.*)\) twice", what):
        name = ".".join(re.findall("'([^']*)'", twice[1]))
        what = f"the table [{name}] is there twice"
    elif what == "Cannot overwrite a value":
        what = "the key in this line is set twice"
    return f"{where}: {what[:1].lower()}{what[1:]}"
