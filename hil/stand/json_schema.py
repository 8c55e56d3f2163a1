"""The JSON schema of stand.toml, for editors that check and complete it; made from the models that check the file."""

from __future__ import annotations

from typing import Any

from pydantic import create_model

from hil.quantities import physical
from hil.stand.devices import BACKENDS, SENSORS
from hil.stand.file import File

_SENSOR = "joint_sensor_"
_NUMBER_AND_UNIT = r"^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*\S"


def stand_schema() -> dict[str, Any]:
    """Return the JSON schema of stand.toml, with the tables of every backend and joint sensor."""
    tables: dict[str, Any] = {name: (device.table_class(), None) for name, device in BACKENDS.items()}
    tables |= {f"{_SENSOR}{kind}": (device.table_class(), None) for kind, device in SENSORS.items()}
    schema = create_model("Stand", __base__=File, **tables).model_json_schema()
    schema["$schema"] = "http://json-schema.org/draft-07/schema#"
    schema["title"] = "stand.toml"
    definitions, properties = schema["$defs"], schema["properties"]
    definitions["StandTable"]["properties"]["backend"] = {"enum": list(BACKENDS), "title": "Backend"}
    for name in (*BACKENDS, *(f"{_SENSOR}{kind}" for kind in SENSORS)):
        properties[name].pop("default", None)  # a table that is left out has no default worth completing
    for kind in (File, *(device.table_class() for device in (*BACKENDS.values(), *SENSORS.values()))):
        for table, key, unit in physical(kind):
            field = definitions[table.__name__]["properties"]
            field[key] = _with_unit(field[key], unit)
    sensors = [_with_kind(kind, _resolved(properties.pop(f"{_SENSOR}{kind}"), definitions)) for kind in SENSORS]
    if sensors:
        properties["joint_sensor"] = {"anyOf": sensors}
    return schema


def _with_unit(field: dict[str, Any], unit: str) -> dict[str, Any]:
    """Return the schema of a physical quantity: a number in SI or a text with a unit."""
    bounds = {name: value for name, value in field.items() if name not in {"title", "default", "description", "anyOf"}}
    text = {"type": "string", "pattern": _NUMBER_AND_UNIT}
    kept = {name: field[name] for name in ("title", "default", "description") if name in field}
    return {"anyOf": [*field.get("anyOf", [bounds]), text], "description": f"{unit}, or a text with its unit"} | kept


def _resolved(field: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a field; if the field is a reference, the definition that it refers to."""
    definition: dict[str, Any] = definitions[str(field["$ref"]).rpartition("/")[2]]
    return definition


def _with_kind(kind: str, table: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a joint sensor's table with the key `kind` added."""
    properties = {"kind": {"const": kind}, **table.get("properties", {})}
    return table | {"properties": properties, "required": ["kind", *table.get("required", [])]}
