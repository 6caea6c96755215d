"""YAML that users write, judged before it is built: what is short on paper must not be endless in memory."""

from __future__ import annotations

import re
from typing import Any

import yaml

# Greatest depth of nested lists and sections; the parser's stack overflows at some 10 000.
_DEEPEST = 100
# Greatest number of characters of a value; an integer of more than 4300 digits cannot be printed.
_LONGEST = 1000

# Numbers with an exponent as in YAML 1.2; YAML 1.1, that of PyYAML, requires a point and the exponent's sign.
_EXPONENT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$")


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """PyYAML's, which reads such numbers, too."""


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))


class YamlError(ValueError):
    """YAML that cannot be read; the message is one line: place and problem."""


def parse_yaml(text: str) -> object:
    """The value of a YAML document; empty ones before and after it, as a dumped message has, do not count.

    Raises:
        YamlError: it is broken, too deep, holds a value too long, a tag such as !!int, or an alias: a few of those, one
            within the other, stand for billions of values; there is more than one document; or something looks like a
            date or a number and is none.
    """
    try:
        return _parsed(text)
    except (ValueError, yaml.YAMLError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        raise YamlError(f"{place}broken YAML: {problem}") from None


def _parsed(text: str) -> object:
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        problem = _problem(event, depth)
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
    documents = [one for one in yaml.load_all(text, Loader=_Loader) if one is not None]
    if len(documents) > 1:
        raise yaml.MarkedYAMLError(problem=f"{len(documents)} documents, parted by ---; keep one of them")
    return documents[0] if documents else None


def dump_yaml(value: object, **style: Any) -> str:
    """A parsed value as YAML: what every reader takes as `parse_yaml` has. style: see PyYAML's dump."""
    return str(yaml.dump(value, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), **style))


def _problem(event: yaml.Event, depth: int) -> str:
    """The fault of a piece of YAML at a depth, "" for none."""
    if depth > _DEEPEST:
        return f"more than {_DEEPEST} levels deep"
    if isinstance(event, yaml.AliasEvent):
        return f"the alias *{event.anchor} is not read, write the value out"
    if getattr(event, "tag", None) is not None:
        return f"the tag {event.tag} is not read, leave it out"
    if isinstance(event, yaml.ScalarEvent) and len(event.value) > _LONGEST:
        return f"a value of more than {_LONGEST} characters"
    return ""
