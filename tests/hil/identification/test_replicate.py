"""The paper's experiment: what is recorded, what is run, and the figures that are reported of it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.identification import replicate as experiment
from hil.identification.replicate import Replication
from hil.recording.reader import Recording
from hil.report.replication import as_json, replication_lines, write_page


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Replication:
    folder = tmp_path_factory.mktemp("replicate")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiment, "_MEASURE", 0.05)
        return experiment.replicate(folder, evaluations=500, trials=3, seed=0, workers=1)


def test_it_is_the_papers_experiment_at_the_scale_asked_for(done: Replication) -> None:
    found = done.identification
    with Recording(found.recordings[0]) as recording:
        assert len(recording) == 2500
    assert (found.preset, len(found.trials.fitness)) == ("paper", 3)
    assert found.trials.evaluations == 3 * (10 + 500)


def test_the_reported_rates_are_the_measured_ones(done: Replication) -> None:
    table = as_json(done)
    assert table["evaluations_per_second"] == pytest.approx(table["evaluations"] / table["seconds"])
    one = table["processor_seconds"] / table["evaluations"]
    assert table["ratio_to_numpy"] == pytest.approx(table["numpy_seconds_per_evaluation"] / one)
    assert table["seconds"] <= done.identification.seconds


def test_table_one_stands_beside_the_papers(done: Replication) -> None:
    kc = as_json(done)["parameters"]["Kc"]
    genes = done.identification.trials.genes[:, 0]
    assert (kc["true"], kc["paper_mean"], kc["paper_std"]) == (17.75e-3, 17.52e-3, 6.62e-3)
    assert kc["trials_mean"] == pytest.approx(np.mean(genes))
    assert kc["trials_std"] == pytest.approx(np.std(genes, ddof=1))
    assert kc["best"] in genes
    text = "\n".join(replication_lines(done))
    assert "17.52 ± 6.6" in text
    assert f"{kc['best'] * 1e3:.4f}" in text


def test_a_single_trial_has_no_spread_in_table_one(done: Replication) -> None:
    found = done.identification
    single = tuple(replace(one, optimiser=replace(one.optimiser, std=math.nan)) for one in found.estimates)
    lines = replication_lines(replace(done, identification=replace(found, estimates=single)))
    assert not any("nan" in line for line in lines)
    assert lines[3].split("std")[1].split() == [f"{one.optimiser.mean * 1e3:.4g}" for one in single]


def test_figure_eight_ends_at_the_best_of_each_trial_and_never_rises(done: Replication, tmp_path: Path) -> None:
    history = done.identification.trials.history
    assert np.all(np.diff(history.fitness, axis=1) <= 0.0)
    np.testing.assert_array_equal(history.fitness[:, -1], done.identification.trials.fitness)
    write_page(done, tmp_path / "figure8.html")
    assert "Figure 8" in (tmp_path / "figure8.html").read_text(encoding="utf-8")
