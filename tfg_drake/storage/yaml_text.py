"""YAML that users write, judged before it is built: what is short on paper must not be endless in memory."""

from __future__ import annotations

import yaml

# Lists and sections within one another; the parser's own stack ends at some 10 000, and the process with it.
_DEEPEST = 100
# Characters of one value; a whole number of more than 4300 digits cannot even be shown.
_LONGEST = 1000

_Loader: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def parse_yaml(text: str) -> object:
    """The value of a YAML document.

    Raises:
        yaml.YAMLError: it is broken, too deep, holds a value too long, a tag such as !!int, or an alias: a few of
            those, one within the other, stand for billions of values.
        ValueError: something looks like a date or a number and is none.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        problem = _problem(event, depth)
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
    return yaml.load(text, Loader=_Loader)


def _problem(event: yaml.Event, depth: int) -> str:
    """What is wrong with a piece of YAML at a depth, "" for nothing."""
    if depth > _DEEPEST:
        return f"more than {_DEEPEST} levels deep"
    if isinstance(event, yaml.AliasEvent):
        return f"the alias *{event.anchor} is not read, write the value out"
    if getattr(event, "tag", None) is not None:
        return f"the tag {event.tag} is not read, leave it out"
    if isinstance(event, yaml.ScalarEvent) and len(event.value) > _LONGEST:
        return f"a value of more than {_LONGEST} characters"
    return ""
