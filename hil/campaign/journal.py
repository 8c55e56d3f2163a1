"""The journal of a campaign: a file with the state of every run. Each change is written atomically, so that a kill
costs at most one run.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.campaign.plan import Plan, Run
from hil.errors import Untrustworthy, WrongUse
from hil.recording.input import read_text
from hil.recording.output import atomic_write
from hil.recording.reader import Recording

NAME = "campaign.json"
SCHEMA = "hil-campaign-journal/1"
_LARGEST = 1 << 26  # bytes of a journal, or of a result


@dataclass(slots=True)
class Entry:
    """The state of a run in the journal. failure: why the run failed, "" if it is done. key: hash of the run's
    settings.
    """

    key: str
    failure: str = ""


class Journal:
    """The journal in the folder of `plan`. Raises WrongUse if that file is no journal of a campaign."""

    def __init__(self, plan: Plan) -> None:
        self._path = plan.folder / NAME
        self._entries = self._read()

    def _read(self) -> dict[str, Entry]:
        if not self._path.exists():
            return {}
        text = read_text(self._path, largest=_LARGEST)
        with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
            table = json.loads(text)
            if table["schema"] == SCHEMA:
                return {name: Entry(str(one["key"]), str(one["failure"])) for name, one in table["runs"].items()}
        raise WrongUse(f"{self._path} is no journal of a campaign: move the file away, or choose another output")

    def failure(self, run: Run) -> str:
        """Return why the last attempt of a run failed, "" if it did not fail."""
        entry = self._entries.get(run.name)
        return "" if entry is None else entry.failure

    def is_done(self, run: Run) -> bool:
        """Return whether a run is recorded. Raises WrongUse if its recording was made with other settings."""
        if not run.path.exists() or self.failure(run):
            return False
        entry = self._entries.get(run.name) or self._recovered(run)
        if entry is None or entry.key != run.key:
            raise WrongUse(
                f"{run.path} was recorded with other settings than the plan now has: choose another output for the new "
                "plan, or move the recording away"
            )
        return True

    def _recovered(self, run: Run) -> Entry | None:
        """Return the entry of a run that was recorded but is missing from the journal because the process was killed.
        None if there is no such recording.
        """
        with suppress(WrongUse, Untrustworthy), Recording(run.path) as recording:
            if recording.complete and str(recording.attributes.get("operator_note", "")) == note(run):
                self.keep(run)
                return self._entries[run.name]
        return None

    def keep(self, run: Run, failure: str = "") -> None:
        """Write into the journal that a run is done, or with a text `failure` that it failed."""
        self._entries[run.name] = Entry(run.key, failure)
        runs = {name: {"key": entry.key, "failure": entry.failure} for name, entry in self._entries.items()}
        with atomic_write(self._path, force=True) as temporary:
            temporary.write_text(json.dumps({"schema": SCHEMA, "runs": runs}, indent=1), encoding="utf-8")


def note(run: Run) -> str:
    """Return the note that is stored in a run's recording, and by which the recording is assigned to the run."""
    return f"campaign run {run.name}, settings {run.key}"


def kept_result(run: Run, model: str, trials: int | None) -> dict[str, Any] | None:
    """Return the stored result of a run for these settings, as a JSON object; None if there is none."""
    path = result_path(run)
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError, WrongUse):
        table = json.loads(read_text(path, largest=_LARGEST))
        if table["of"] == [run.key, model, trials, run.path.stat().st_mtime_ns]:
            return dict(table["result"])
    return None


def keep_result(run: Run, model: str, trials: int | None, result: dict[str, Any]) -> None:
    """Store the result of a run, a JSON object, beside its recording."""
    of = [run.key, model, trials, run.path.stat().st_mtime_ns]
    with atomic_write(result_path(run), force=True) as temporary:
        temporary.write_text(json.dumps({"of": of, "result": result}, indent=1), encoding="utf-8")


def result_path(run: Run) -> Path:
    """Return the path of the file that holds a run's result."""
    return run.path.with_suffix(".json")
