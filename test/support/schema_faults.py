"""What a file's schema says against it, by a validator that is not the project's."""

import json
from pathlib import Path

from jsonschema import Draft202012Validator

from rx90_common.base.config import read_yaml
from rx90_common.base.share import config_path


def schema_faults(kind: str, path: Path) -> list[str]:
    schema = json.loads(config_path(f"schemas/{kind}.json").read_text(encoding="utf-8"))
    return [error.message for error in Draft202012Validator(schema).iter_errors(read_yaml(path))]
