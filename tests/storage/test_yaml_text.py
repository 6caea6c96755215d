"""YAML of users: what is short on paper and endless in memory is refused, and its place named."""

import pytest
import yaml

from tfg_drake.storage.yaml_text import parse_yaml


def test_plain_yaml_is_read():
    assert parse_yaml("a: [1, 2.5, {b: yes}]\nc: text\n") == {"a": [1, 2.5, {"b": True}], "c": "text"}
    assert parse_yaml("") is None


@pytest.mark.parametrize(
    ("text", "line", "problem"),
    [
        ("a: 1\nb: " + "[" * 100_000, 2, "more than 100 levels deep"),
        ("{a: " * 100_000, 1, "more than 100 levels deep"),
        ("a: &x [1]\nb:\n- *x", 3, "the alias *x is not read, write the value out"),
        ("a: &x [*x]", 1, "the alias *x is not read, write the value out"),
        ("a: !!timestamp soon", 1, "the tag tag:yaml.org,2002:timestamp is not read, leave it out"),
        ("a: 0x" + "f" * 5000, 1, "a value of more than 1000 characters"),
    ],
)
def test_what_is_endless_is_refused(text, line, problem):
    with pytest.raises(yaml.MarkedYAMLError) as error:
        parse_yaml(text)
    assert error.value.problem == problem
    assert error.value.problem_mark.line == line - 1
