"""Parsed YAML as dataclasses, by the annotations of their fields, which may hold constraints (constraints.py)."""

from __future__ import annotations

import dataclasses
import difflib
import re
import sys
import types
import typing
from pathlib import Path
from typing import Any

from tfg_drake.constraints import USUAL

# The words for an expected value by the type of its annotation.
_EXPECTED = {list: "a list", float: "a number", int: "a whole number", str: "text", bool: "true or false"}

# A class and its body; comments and the fields right below them; the names of those that are no sections.
_CLASS = re.compile(r"^class (\w+).*:\n((?:(?:    .*)?\n)+)", re.MULTILINE)
_COMMENTED = re.compile(r"((?:^    # .*\n)+)((?:^    \w+: .*\n)+)", re.MULTILINE)
_FIELD = re.compile(r"^    (\w+): (?!.*=[\w.]*Config\)$)", re.MULTILINE)


class Misfit(ValueError):
    """A value that does not fit its annotation; the message is one line: its place, what is wrong, how to mend it."""


def read(value: Any, annotation: Any, place: str = "", default: Any = None) -> Any:
    """A parsed value as one of an annotation: a dataclass, a list, a number, a text, true or false.

    Of a section the keys that are there are merged into `default`, a dataclass, or into a new one, which has no default
    for what it requires. place: where it is, such as "world.tags[3]". Raises Misfit.
    """
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        if value is None:
            return None
        annotation = typing.get_args(annotation)[0]
    if dataclasses.is_dataclass(annotation):
        return _read_section(value, annotation, place, default)
    has_own = typing.get_origin(annotation) is typing.Annotated
    annotation, *constraints = typing.get_args(annotation) if has_own else (annotation, *USUAL.get(annotation, ()))
    kind = typing.get_origin(annotation) or annotation
    fits = isinstance(value, int | float if kind is float else kind)
    if not fits or isinstance(value, bool) != (kind is bool):
        raise Misfit(f"{place}: expected {_EXPECTED[kind]}, found {described(value)}")
    if kind in (int, float) and not abs(value) <= sys.float_info.max:
        raise Misfit(f"{place}: must be finite, is {value if isinstance(value, float) else 'too large'}")
    for constraint in constraints:
        if told := constraint.fault(value):
            raise Misfit(f"{place}: {told}")
    if kind is list:
        (items,) = typing.get_args(annotation)
        return [read(item, items, f"{place}[{i}]") for i, item in enumerate(value)]
    return kind(value)


def _read_section(tree: object, section: Any, place: str, default: Any) -> Any:
    if not isinstance(tree, dict):
        raise Misfit(f"{place}: expected a section of keys, found {described(tree)}")
    given = {}
    for key, item in tree.items():
        annotation = annotation_of(section, key, place)
        given[key] = read(item, annotation, f"{place}.{key}" if place else key, getattr(default, key, None))
    if default is not None:
        return dataclasses.replace(default, **given)
    required = [one.name for one in dataclasses.fields(section) if one.default is one.default_factory]  # both missing
    if missing := [key for key in required if key not in given]:
        raise Misfit(f"{place}.{missing[0]}: missing; write {section.example}")
    return section(**given)


def annotation_of(section: Any, key: object, place: str) -> Any:
    """The annotation of a section's value. Raises Misfit with the valid keys that look like it, or all of them, where
    it has no such key or is no section."""
    fields = dataclasses.fields(section) if dataclasses.is_dataclass(section) else ()
    known = {field.name: field.type for field in fields}
    if key in known:
        return known[key]
    full = f"{place}.{key}" if place else str(key)
    if not known:
        raise Misfit(f"{full}: unknown key; {place} is a value, not a section")
    if near := difflib.get_close_matches(str(key), known, cutoff=0.5):
        raise Misfit(f"{full}: unknown key; did you mean {' or '.join(near)}?")
    where = f"the keys of {place}" if place else "the sections"
    raise Misfit(f"{full}: unknown key; {where} are {', '.join(known)}")


def described(value: object) -> str:
    """A parsed value in words."""
    names = {dict: "a section", list: "a list", str: "text", bool: "a yes/no value", type(None): "nothing"}
    kind = names.get(type(value), type(value).__name__)
    return f"{kind} ({value!r})" if isinstance(value, str | bool | int | float) else kind


def document_fields(module: dict[str, Any]) -> None:
    """Add the comments above the fields of a module's dataclasses to the docstrings of these, where help() finds them.
    module: its globals."""
    for name, body in _CLASS.findall(Path(module["__file__"]).read_text(encoding="utf-8")):
        if dataclasses.is_dataclass(module[name]):
            for comment, fields in _COMMENTED.findall(body):
                names = _FIELD.findall(fields) or [fields.strip().partition(":")[0]]
                told = comment.strip().removeprefix("# ").replace("    # ", "")
                module[name].__doc__ = f"{module[name].__doc__}\n\n{', '.join(names)}: {told}"
