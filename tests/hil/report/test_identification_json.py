"""The JSON object of `hil identify`, and the one of an earlier version in its words."""

from __future__ import annotations

import pytest

from hil.errors import WrongUse
from hil.identification.result import Identification
from hil.report.identification_json import as_json, upgraded


def test_a_json_object_of_version_1_is_read_in_the_words_of_version_2() -> None:
    parameter = {"value": 0.021, "exact": 0.02, "trials_mean": 0.022, "trials_std": None, "identifiable": True}
    step = {"term": "skew", "taken": False, "held_out": 2e-4, "Kc": 0.02}
    old = {
        "schema": "hil-identification/1",
        "parameters": {"Kc": parameter},
        "fitness": {"value": 1.1e-4, "exact_optimum": 1e-4, "relative_gap": 0.1, "unit": "N*m"},
        "holdout": {"fitness": 1e-4, "nrmse": 0.02},
        "warnings": [{"code": "unsteady", "parameter": "Kc", "message": ""}],
        "ladder": [step],
        "fixture": {"recording": "rig.h5", "parameters": {"Kc": parameter}},
    }
    kc = {
        "value": 0.02,
        "identifiable": True,
        "optimiser_repeatability": {"best": 0.021, "trials_mean": 0.022, "trials_std": None},
    }
    assert upgraded(old) == {
        "schema": "hil-identification/2",
        "parameters": {"Kc": kc},
        "fitness": {"value": 1e-4, "best_trial": 1.1e-4, "optimiser_gap": 0.1, "unit": "N*m"},
        "validation": {"fitness": 1e-4, "nrmse": 0.02},
        "warnings": [{"code": "misfit", "parameter": "Kc", "message": ""}],
        "errors": [],
        "model_selection": [{"term": "skew", "decision": "rejected", "validation_fitness": 2e-4, "Kc": 0.02}],
        "fixture": {"recording": "rig.h5", "parameters": {"Kc": kc}},
    }


def test_a_json_object_of_this_version_is_read_as_it_is_and_one_of_another_refused(found: Identification) -> None:
    table = as_json(found)
    assert upgraded(table) == table
    for schema in ("hil-identification/3", "hil-comparison/2", None):
        with pytest.raises(WrongUse, match=rf"written as schema {schema!r}.*the version that wrote it"):
            upgraded(table | {"schema": schema})
