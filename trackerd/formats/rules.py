"""What a schema found wrong, in the words of the person who edits the file: one line each, `file [table] key = value: rule`."""

import json
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from types import UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from trackerd.formats.settings import KeyRuleError

LONGEST_VALUE = 80
NO_VALUE = object()
WORDS = {
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "string_type": "must be text in quotes",
    "path_type": "must be a path in quotes",
    "tuple_type": "must be a list in [ ]",
    "list_type": "must be a list in [ ]",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "missing": "is missing and has no default",
}
LENGTHS = {"too_short", "too_long"}
BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


def line(file: str, table: Sequence[str], key: str | None, value: Any, rule: str) -> str:
    """One error. A key of None speaks of the whole table; NO_VALUE leaves the value out."""
    where = f"{file} [{'.'.join(map(_bare, table))}]" if table else file
    if key is None:
        return f"{where}: {rule}"
    if value is NO_VALUE:
        return f"{where} {key}: {rule}"
    return f"{where} {key} = {shown(value)}: {rule}"


def shown(value: Any) -> str:
    """A value as TOML writes it, shortened."""
    if isinstance(value, Mapping):
        return "{ ... }"
    if isinstance(value, float):
        return repr(value)  # nan and inf as TOML writes them
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 4] + " ..."


def explain(file: str, table: Sequence[str], model: type[BaseModel], raw: Mapping[str, Any], found: ErrorDetails) -> str:
    """The line for one of pydantic's errors in the `table` that holds `raw`."""
    names, key, value, field = _locate(model, raw, found["loc"])
    where = (*table, *names)
    if found["type"] == "extra_forbidden":
        return line(file, where, key, value, "unknown key" + nearest(str(key), _keys(model, names)))
    if found["type"] == "value_error":
        error = found["ctx"]["error"]
        if isinstance(error, KeyRuleError):
            key, value = error.key, found["input"].get(error.key, NO_VALUE)
        return line(file, where, key, value, str(error))
    return line(file, where, key, value, _rule(found, field))


def nearest(name: str, known: Sequence[str]) -> str:
    """A hint at the known name that was probably meant."""
    close = get_close_matches(name, known, n=1)
    return f" (did you mean {close[0]}?)" if close else f" (known: {', '.join(known)})"


def _rule(found: ErrorDetails, field: FieldInfo | None) -> str:
    kind = found["type"]
    if kind == "missing" and found["loc"] and isinstance(found["loc"][-1], int):
        return f"needs {_count(field)} values"
    if kind in LENGTHS:
        return f"needs {_count(field)} values"
    if kind in WORDS:
        return WORDS[kind]
    if kind == "literal_error":
        return f"must be one of {found['ctx']['expected']}".replace("'", '"')
    bounds = [f"{BOUNDS[name]} {limit:g}" for name, limit in _bounds(found, field) if name in BOUNDS]
    if bounds:
        return "must be " + " and ".join(bounds)
    message = found["msg"].replace("Input should be", "must be")
    return message[:1].lower() + message[1:]


def _bounds(found: ErrorDetails, field: FieldInfo | None) -> Iterator[tuple[str, float]]:
    """All bounds of the field where it carries them, else the one that was broken."""
    broken = {name: limit for name, limit in found.get("ctx", {}).items() if name in BOUNDS}
    marks = field.metadata if field else []
    every = {name: getattr(mark, name) for mark in marks for name in BOUNDS if hasattr(mark, name)}
    yield from (every if broken.keys() <= every.keys() else broken).items() if broken else ()


def _count(field: FieldInfo | None) -> int | str:
    """How many values a fixed tuple has."""
    annotation: Any = field.annotation if field else None
    for candidate in (annotation, *get_args(annotation)):
        if get_origin(candidate) is tuple and Ellipsis not in get_args(candidate):
            return len(get_args(candidate))
    return "other"


def _locate(
    model: type[BaseModel], raw: Mapping[str, Any], path: Sequence[str | int]
) -> tuple[tuple[str, ...], str | None, Any, FieldInfo | None]:
    """Tables inside `raw`, key, value and field of an error's path. The key is None where the path ends at a known table."""
    names: list[str] = []
    here: Any = raw
    for step in path:
        field = _field(model, names, str(step))
        value = here.get(step, NO_VALUE)
        if not isinstance(value, Mapping):
            return tuple(names), str(step), value, field
        names.append(str(step))
        here = value
    if names and _annotation(model, names) is None:  # a table where a plain value belongs, or one that nobody knows
        return tuple(names[:-1]), names[-1], here, None
    return tuple(names), None, here, None


def _field(model: type[BaseModel], names: Sequence[str], key: str) -> FieldInfo | None:
    holder = _model_in(_annotation(model, names))
    return holder.model_fields.get(key) if holder else None


def _keys(model: type[BaseModel], names: Sequence[str]) -> list[str]:
    holder = _model_in(_annotation(model, names))
    return list(holder.model_fields) if holder else []


def _annotation(model: type[BaseModel], names: Sequence[str]) -> Any:
    """The type of a nested table: a model, or a dict of them by name. None where there is no such table."""
    found: Any = model
    for name in names:
        holder = _model_in(found)
        if holder is None:
            found = get_args(found)[1] if get_origin(found) is dict else None
        else:
            found = holder.model_fields[name].annotation if name in holder.model_fields else None
    return found if _model_in(found) or get_origin(found) is dict else None


def _model_in(annotation: Any) -> type[BaseModel] | None:
    candidates = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    return next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)


def _bare(name: str) -> str:
    return name if name.replace("-", "").replace("_", "").isalnum() else json.dumps(name, ensure_ascii=False)
