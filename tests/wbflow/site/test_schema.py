"""The JSON schema with which editors check site files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from wbflow.cli.main import main

TEMPLATE = Path(__file__).parents[3] / "sites" / "template.yaml"


@pytest.fixture
def validator() -> Any:
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(CliRunner().invoke(main, ["schema"]).stdout)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_the_template_is_valid_by_the_schema(validator: Any) -> None:
    data = json.loads(json.dumps(yaml.safe_load(TEMPLATE.read_text()), default=str))
    assert [error.message for error in validator.iter_errors(data)] == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"camras": ["gate"]},
        {"resolution": 12},
        {"pairs": {"degree": "six"}},
        {"cameras": [{"id": "gate", "intrinsics": {"f": 900}}]},
        {"keep": {"nights": "some"}},
    ],
)
def test_wrong_keys_and_values_are_invalid(validator: Any, wrong: dict[str, Any]) -> None:
    right = {"site": "yard", "captures": {"pattern": "{camera}.jpg"}, "cameras": ["gate", "roof"]}
    assert validator.is_valid(right)
    assert not validator.is_valid(right | wrong)
