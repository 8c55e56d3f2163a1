"""One run, from a free place on disk to a finished file: the stand, the servo, the recorder and the store together."""

from __future__ import annotations

from pathlib import Path

from hil.errors import WrongUse
from hil.live import beside
from hil.part import Header, PartFile
from hil.profiles import Profile
from hil.recorder import Outcome, Recorder, tick_count
from hil.stand import Stand, check_backend, open_servo
from hil.stop import StopRequest
from hil.target import check_target, next_free


def run(
    stand: Stand,
    profile: Profile,
    *,
    rate: float,
    seed: int,
    realtime: bool = False,
    note: str = "",
    command_line: str = "",
    output: Path | None = None,
    force: bool = False,
) -> tuple[Path, Outcome]:
    """Record `profile` on `stand` at `rate` Hz into `output` (None: the next free recordings/runN.h5).

    The servo is closed, and the torque off, however it ends; the outcome says how that was. seed: of the simulator.
    Raises WrongUse before anything moves, DriverError where the servo cannot be opened.
    """
    check_backend(stand.stand.backend)
    path = next_free(Path("recordings")) if output is None else output
    check_target(path, force=force)
    with StopRequest().listening() as stop:
        servo, truth = open_servo(stand, seed=seed, realtime=realtime)
        try:
            header = Header(
                profile=profile.attributes() | {"rate": rate},
                stand_toml=stand.text,
                truth=truth,
                seed=seed,
                operator_note=note,
                command_line=command_line,
            )
            with PartFile(path, header, tick_count(profile, rate)) as part, beside(part.path):
                outcome = Recorder(stand, servo, profile, rate, part).run(stop)
        finally:
            servo.close()
        if not outcome.samples:
            part.discard()
        else:
            try:
                part.finish(outcome.end_reason)
            except WrongUse as error:
                raise WrongUse(f"{error}\nThe run itself is safe: hil recover {part.path} -o OTHER.h5") from error
    return path, outcome
