"""One complete run: open the stand's servo, choose a free file name, record, and finish the file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from drivers.clock import MonotonicClock
from drivers.servo import Quantity, Servo, ServoInfo
from drivers.torque_off import Alarm
from hil.acquisition.commissioning import Agree, permitted, require_agreement
from hil.acquisition.excitation import Profile
from hil.acquisition.guard import longest_silence
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.phases import Outcome, Phase
from hil.acquisition.planned_faults import FaultyHost
from hil.acquisition.real_time import connecting
from hil.acquisition.recorder import Recorder, tick_count
from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.guardian.servo import Watch
from hil.live.rerun import check as check_rerun
from hil.live.viewer import beside
from hil.printable import quoted
from hil.recording.background import BackgroundWriter
from hil.recording.channels import TorqueScale
from hil.recording.output import (
    NameTaken,
    check_folder,
    check_output,
    check_recording_name,
    check_unfinished,
    next_free,
    part_path,
    recording_path,
    remove_unfinished,
)
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.stand.devices import check_backend
from hil.stand.file import Stand
from hil.stand.opening import open_servo, require_quiet_neighbours
from sim_backend.fault_plan import FaultPlan
from sim_backend.faulty_servo import FaultyServo

_FOLDER = Path("recordings")
_OVERTIME = 2.0  # s beyond the profile for which the torque may be on
_HELD_BACK = 0.02  # s of rows that a killed process may lose
_HAS_SHARED_MEMORY = sys.platform != "win32"

Writer = RecordingWriter | BackgroundWriter


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
    guardian: bool = True,
    rerun: str = "",
    alarm: Alarm | None = None,
    faults: FaultPlan | None = None,
    warn: Callable[[list[Diagnostic]], object] = lambda _: None,
    agree: Agree | None = None,
) -> tuple[Path, Outcome]:
    """Record `profile` on `stand` at `rate` Hz into `output` (None: the next free recordings/runN.h5).

    Return the recording's path and the outcome of the run. On every path the torque is off and the servo closed.
    seed: of the simulator. realtime: whether a simulated stand runs in wall time. note, command_line: texts stored in
    the recording. force: replace an existing recording of that name, finished or not. guardian: whether a second
    process switches the torque off if this one is killed, frozen or late. rerun: "window" or a file .rrd, in which
    Rerun shows the run; "" for neither. alarm: called at once if the torque may still be on, and if it is off later.
    faults: planned faults of a simulated stand. warn: called with the warnings about the opened drive.
    agree: called before anything is opened if a real motor moves for the first time; it raises to refuse. Raises
    WrongUse before anything moves, DriverError if the servo cannot be opened.
    """
    host, outcome = FaultyHost(), Outcome()
    output = _checked(stand, output, rerun, force=force)
    if faults is not None and "disk-frozen" in faults.kinds() and not realtime:
        raise WrongUse("disk-frozen: this fault has no effect in virtual time: add --realtime")
    require_agreement(stand, profile.mode, _motion(stand, profile), agree)
    with StopRequest().listening() as stop:
        servo, truth = _opened(stand, profile, (faults, host), seed=seed, realtime=realtime, guardian=guardian)
        try:
            allowed = _allowed(stand, servo, profile, warn)
            header = Header(
                profile=profile.attributes() | {"rate": rate},
                stand_toml=stand.text,
                truth=truth,
                seed=seed,
                operator_note=note,
                command_line=command_line,
                torque_scale=_torque_scale(stand, servo.info),
            )
            begun = _begin(output, header, tick_count(profile, rate), max(1, int(_HELD_BACK * rate)), force=force)
            writer = _behind(begun, servo, rate)
            try:
                with beside(writer.path, rerun):
                    sink = writer if faults is None else host.sink(writer)
                    folder = writer.path.parent
                    outcome = Recorder(allowed, servo, profile, rate, sink, scratch=folder, alarm=alarm).run(stop)
            except BaseException:
                _close(writer)
                raise
        finally:
            _close_servo(servo, outcome)
        return _finish(writer, outcome, force=force), outcome


def _torque_scale(stand: Stand, info: ServoInfo) -> TorqueScale:
    """Return how well the scale of the torque that `stand` uses is known: that of the drive's torque, or the cell's."""
    if stand.sensor is not None and stand.stand.torque_source == "joint":
        return TorqueScale(source="the torque cell")
    known = info.torque_uncertainty
    if known == 0.0:
        return TorqueScale(known)
    return TorqueScale(known, f"{info.model}'s torque constant of the maker's table" if known > 0.0 else info.model)


def _motion(stand: Stand, profile: Profile) -> str:
    """Return what the motor will do, in the words of an announcement."""
    size = f"with up to {profile.amplitude:g} N m"
    if profile.mode is Quantity.POSITION:
        size = f"by up to {profile.amplitude:g} rad with at most {stand.checked_limits().torque:g} N m"
    return f"will move {size} at the joint for {profile.duration:g} s."


def _opened(
    stand: Stand,
    profile: Profile,
    faulty: tuple[FaultPlan | None, FaultyHost],
    *,
    seed: int,
    realtime: bool,
    guardian: bool,
) -> tuple[Servo, Mapping[str, float]]:
    """Return the open servo with its planned faults, and the true parameters if it is simulated. Raises DriverError."""
    plan, host = faulty
    watch = Watch(longest_silence(), profile.duration + _OVERTIME) if guardian else None
    watched = plan is None or "broken-watchdog" not in plan.kinds()
    with connecting(stand.stand.backend):
        servo, truth = open_servo(
            stand, quantity=profile.mode, seed=seed, realtime=realtime, watch=watch, watched=watched
        )
    return (servo if plan is None else FaultyServo(servo, plan, host)), truth


def _allowed(stand: Stand, servo: Servo, profile: Profile, warn: Callable[[list[Diagnostic]], object]) -> Stand:
    """Return the stand with the torque limit that its drive may use. Raises WrongUse, also if another drive on its bus
    holds torque.
    """
    require_quiet_neighbours(stand, servo)
    stand, warnings = permitted(stand, servo.info, profile)
    warn(warnings)
    return stand


def _checked(stand: Stand, output: Path | None, rerun: str, *, force: bool) -> Path | None:
    """Return the recording's path, None if it has no name yet. Raises WrongUse for an unknown backend, and for an
    output that cannot be written.
    """
    check_backend(stand.stand.backend)
    if rerun:
        check_rerun(rerun, force=force)
    if output is None:
        check_folder(_FOLDER)
        return None
    inputs, output = stand.named_files(), recording_path(output)
    check_output(output, force=force, inputs=inputs)
    check_recording_name(output)
    check_output(part_path(output), force=True, inputs=inputs)
    check_unfinished(output, force=force)
    return output


def _begin(output: Path | None, header: Header, length: int, batch: int, *, force: bool) -> RecordingWriter:
    """Return the writer of a new recording, under a name that no other process takes at the same time. length: rows to
    reserve. batch: rows that are written together.
    """
    if output is not None:
        if force:
            remove_unfinished(output)
        return RecordingWriter(output, header, length, batch=batch)
    while True:
        path = next_free(_FOLDER)
        try:
            writer = RecordingWriter(path, header, length, batch=batch)
        except NameTaken:
            continue
        if not path.exists():
            return writer
        writer.discard()  # another recorder began and ended under this name since we looked


def _behind(writer: RecordingWriter, servo: Servo, rate: float) -> Writer:
    """Return a writer that writes the rows in another process if the clock is real, so that the loop never waits for
    the disk.
    """
    if not (_HAS_SHARED_MEMORY and isinstance(servo.clock, MonotonicClock)):
        return writer
    try:
        return BackgroundWriter(writer, rate)
    except BaseException:
        writer.discard()
        raise


def _close(writer: Writer) -> None:
    with writer:
        if not len(writer):
            writer.discard()


def _close_servo(servo: Servo, outcome: Outcome) -> None:
    try:
        servo.close()
        outcome.phases.enter(Phase.CLOSED, servo.clock.now())
    except BaseException as error:  # noqa: BLE001 - the data of a run outlives a fault of its driver
        outcome.error = outcome.error or error


def _is_readable(part: Path) -> bool:
    """Return whether the unfinished file `part` exists and its rows can be recovered."""
    with suppress(WrongUse, Untrustworthy, OSError), Recording(part):
        return True
    return False


def _finish(writer: Writer, outcome: Outcome, *, force: bool) -> Path:
    """Make the recording final and return its path. If that fails, store the failure in the outcome: the `.part` keeps
    all rows.
    """
    try:
        with writer:
            if len(writer):
                path = writer.finish(outcome.end_reason, force=force)
                outcome.moved = writer.moved
                return path
            writer.discard()
    except Exception as error:  # noqa: BLE001 - in any case the user must learn where the data is
        kept = writer.path if writer.path.exists() else None
        safe = f"\nThe run itself is safe: hil recover {quoted(writer.path)} -o OTHER.h5"
        hint = safe if _is_readable(writer.path) else ""
        failure = WrongUse(f"{error}{hint}")
        failure.__cause__ = error
        if outcome.error is None:
            outcome.error = failure
        else:  # two things to say: why the run ended, and where its rows are
            outcome.moved = str(failure)
        return kept or writer.final
    return writer.final
