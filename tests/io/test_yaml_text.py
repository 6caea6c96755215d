"""YAML of users: what is short on paper and endless in memory is refused, and its place named."""

import re

import pytest

from tfg_drake.io.yaml_text import YamlError, dump_yaml, parse_yaml


def test_plain_yaml_is_read():
    assert parse_yaml("a: [1, 2.5, {b: yes}]\nc: text\n") == {"a": [1, 2.5, {"b": True}], "c": "text"}
    assert parse_yaml("") is None


@pytest.mark.parametrize("text", ["5e-2", "1e-05", "6e2", "-3E-7", "+1.e3", ".5E+1", "1.5e300", "2e400"])
def test_numbers_with_an_exponent_are_numbers(text):
    assert parse_yaml(f"a: {text}") == {"a": float(text)}
    assert parse_yaml(dump_yaml({"a": float(text)})) == {"a": float(text)}


@pytest.mark.parametrize("text", ["1e3x", "e5", "e-5", "'1e3'", "1e", "1e3 m", "1_0e3", "v1e3"])
def test_what_only_looks_like_a_number_is_text(text):
    assert parse_yaml(f"a: {text}") == {"a": text.strip("'")}


def test_empty_documents_beside_one_do_not_count():
    assert parse_yaml("---\na: 1\n---\n") == {"a": 1}
    with pytest.raises(YamlError, match="2 documents, parted by ---; keep one of them"):
        parse_yaml("a: 1\n---\na: 2\n")


@pytest.mark.parametrize(
    ("text", "line", "problem"),
    [
        ("a: 1\nb: " + "[" * 900, 2, "more than 100 levels deep"),
        ("{a: " * 900, 1, "more than 100 levels deep"),
        ("a: &x [1]\nb:\n- *x", 3, "the alias *x is not read, write the value out"),
        ("a: &x [*x]", 1, "the alias *x is not read, write the value out"),
        ("a: !!timestamp soon", 1, "the tag tag:yaml.org,2002:timestamp is not read, leave it out"),
        ("a: 0x" + "f" * 5000, 1, "a value of more than 1000 characters"),
    ],
)
def test_what_is_endless_is_refused(text, line, problem):
    with pytest.raises(YamlError, match=rf"^line {line}, column \d+: broken YAML: {re.escape(problem)}$"):
        parse_yaml(text)


@pytest.mark.parametrize("text", ["a: " + "[" * 100_000, "{a: " * 100_000])
def test_what_is_too_deep_for_the_parser_is_refused_by_it(text):
    with pytest.raises(YamlError, match=r"^line 1, .*: (more than 100 levels deep|exceeded maximum nesting depth)$"):
        parse_yaml(text)
