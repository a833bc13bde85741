"""What stands at the root for others: one version everywhere, citation, forms, links that hold."""

import json
import re
import shlex
import tomllib
from datetime import date
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from typer.main import get_command

from racines_leaderboard.cli.command import app
from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
ZENODO = json.loads((ROOT / ".zenodo.json").read_text())
FORMS = sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"))
PAGES = [ROOT / name for name in ("SECURITY.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md")]
PAGES += [ROOT / "CHANGELOG.md", ROOT / ".github/PULL_REQUEST_TEMPLATE.md"]
RELEASE = re.compile(r"^## (\d+\.\d+\.\d+) - (\d{4}-\d\d-\d\d)$", re.MULTILINE)
LINE = {"type": "string", "minLength": 1}
PERSON = {
    "type": "object",
    "required": ["family-names"],
    "properties": {"family-names": LINE, "given-names": LINE, "orcid": LINE, "affiliation": LINE},
    "additionalProperties": False,
}
ENTITY = {
    "type": "object",
    "required": ["name"],
    "properties": {"name": LINE, "website": LINE},
    "additionalProperties": False,
}
AUTHORS = {"type": "array", "minItems": 1, "items": {"anyOf": [PERSON, ENTITY]}}
CFF = {
    "type": "object",
    "required": ["cff-version", "message", "title", "authors"],
    "properties": {
        "cff-version": {"const": "1.2.0"},
        "type": {"enum": ["software", "dataset"]},
        "keywords": {"type": "array", "items": LINE, "uniqueItems": True},
        "authors": AUTHORS,
        "references": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["type", "title", "authors"],
                "properties": {"authors": AUTHORS, "year": {"type": "integer"}},
            },
        },
    }
    | {key: LINE for key in ("title", "message", "abstract", "version", "license", "doi", "url")}
    | {"date-released": {"type": "string", "pattern": r"^\d{4}-\d\d-\d\d$"}},
    "additionalProperties": False,
}
"""The part of the Citation File Format 1.2.0 that is used here."""
FIELD = {
    "type": "object",
    "required": ["type", "attributes"],
    "properties": {
        "type": {"enum": ["markdown", "textarea", "input", "dropdown", "checkboxes"]},
        "id": {"type": "string", "pattern": "^[a-z-]+$"},
        "attributes": {
            "type": "object",
            "properties": {
                **{key: LINE for key in ("label", "description", "placeholder", "render", "value")},
                "options": {"type": "array", "minItems": 1},
            },
            "additionalProperties": False,
        },
        "validations": {"type": "object", "properties": {"required": {"type": "boolean"}}},
    },
    "additionalProperties": False,
}
FORM = {
    "type": "object",
    "required": ["name", "description", "body"],
    "properties": {
        "name": LINE,
        "description": LINE,
        "title": LINE,
        "labels": {"type": "array", "items": LINE},
        "body": {"type": "array", "minItems": 1, "items": FIELD},
    },
    "additionalProperties": False,
}
"""Of GitHub's issue forms."""


def test_the_version_is_one_everywhere():
    version, released = RELEASE.findall((ROOT / "CHANGELOG.md").read_text())[0]
    stated = (PROJECT["version"], CITATION["version"], ZENODO["version"])
    assert stated == (version,) * 3
    assert str(CITATION["date-released"]) == ZENODO["publication_date"] == released
    assert date.fromisoformat(released)
    assert f"{version.partition('.')[0]}.x" in (ROOT / "SECURITY.md").read_text()


def test_the_changelog_is_in_order():
    text = (ROOT / "CHANGELOG.md").read_text()
    heads = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert heads[0] == "Unreleased" and len(heads) == 1 + len(RELEASE.findall(text))
    released = [tuple(map(int, version.split("."))) for version, _ in RELEASE.findall(text)]
    assert released == sorted(released, reverse=True)
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert {*re.findall(r"^### (.+)$", text, re.MULTILINE)} <= kinds


def test_the_citation_is_one_of_the_format():
    told = {key: str(value) if key == "date-released" else value for key, value in CITATION.items()}
    jsonschema.validate(told, CFF)


def test_archives_say_what_the_citation_and_the_package_say():
    assert ZENODO["title"] == CITATION["title"]
    assert ZENODO["description"] == CITATION["abstract"].strip()
    names = [each["name"] for each in PROJECT["authors"]]
    assert [each["name"] for each in ZENODO["creators"]] == names
    assert [each["name"] for each in CITATION["authors"]] == names
    assert ZENODO["keywords"] == CITATION["keywords"] == PROJECT["keywords"]
    assert ZENODO["license"] == CITATION["license"] == PROJECT["license"]
    assert ZENODO["upload_type"] == CITATION["type"] and ZENODO["access_right"] == "open"
    for paper, line in zip(CITATION["references"], ZENODO["references"], strict=True):
        assert paper["title"] in line and f"({paper['year']})" in line
        assert all(author["family-names"] in line for author in paper["authors"])


@pytest.mark.parametrize("path", FORMS, ids=[path.stem for path in FORMS])
def test_forms_are_such_as_the_host_takes(path: Path):
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    if path.stem == "config":
        assert set(form) <= {"blank_issues_enabled", "contact_links"}
        return
    jsonschema.validate(form, FORM)
    asked = [each for each in form["body"] if each["type"] != "markdown"]
    ids = [each["id"] for each in asked]
    assert len({*ids}) == len(ids) and all("label" in each["attributes"] for each in asked)
    for each in form["body"]:
        options = each["attributes"].get("options")
        assert (options is not None) == (each["type"] in ("dropdown", "checkboxes"))
        assert all(isinstance(o, dict) == (each["type"] == "checkboxes") for o in options or ())


def test_commands_in_forms_and_pages_exist():
    found = set()
    for path in (*FORMS, *PAGES[:2], PAGES[-1]):
        found |= set(re.findall(r"`racines ([^`]+)`", path.read_text()))
    assert len(found) >= 4
    for words in found:
        command: Any = get_command(app)
        rest = shlex.split(words)
        while hasattr(command, "commands") and rest and rest[0] in command.commands:
            command = command.commands[rest.pop(0)]
        known = {option for each in command.params for option in each.opts}
        if hasattr(command, "commands"):  # a group: only the root's switches stand alone
            assert rest and all(word.startswith("--") for word in rest), words
        assert {word for word in rest if word.startswith("--")} <= known, words


@pytest.mark.parametrize("path", PAGES, ids=[path.stem for path in PAGES])
def test_links_of_pages_at_the_root_hold(path: Path):
    for link in re.findall(
        r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")
    ):
        assert (path.parent / link).exists(), link


def test_forms_and_pages_name_no_address():
    for path in (*FORMS, *PAGES, ROOT / "CITATION.cff", ROOT / ".zenodo.json"):
        assert not re.search(r"[\w.+-]+@[\w-]+\.\w+", path.read_text()), path
