"""Assess the quality of a recording: lost replies, saturated torque, late ticks, few encoder counts, noise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.servo import Status
from ga.arrays import Array
from hil.diagnostics import Diagnostic, again, driven_by_position, lateness
from hil.recording.channels import LARGEST
from hil.recording.reader import Recording
from hil.signals import constants as c
from hil.signals.defects import Defects
from hil.signals.deflection_noise import smallest_step
from hil.signals.plausibility import Swing, negative_stiffness, unit_diagnostics, wrong_sign
from hil.signals.prepare import Signals
from hil.signals.rate.savitzky_golay import kernel, local_polynomial, widest
from hil.signals.slow_channel import Slower
from hil.signals.stamps import mean_step
from hil.stand.file import LimitsTable


@dataclass(frozen=True, slots=True)
class Quality:
    """The quality of a recording.

    samples: number of rows of the file. saturated, late: numbers of rows with these flags. torque_from: where the
    torque comes from: "joint", "motor", "given" or "mixed". torque, N m, and deflection, rad: peak to peak.
    deflection_lsb: the smallest step between readings, rad. torque_noise: standard deviation of the torque about a
    local polynomial, N m. snr: ratio of the torque's variance to that noise's, dB; infinite without noise. slower: the
    sensors that are slower than the ticks. highest: the frequency up to which the joint moved, Hz. negative: the
    stiffness, N m/rad, if a sign is wrong. has_unused_rate: whether the table has a column with the rate.
    """

    samples: int
    defects: Defects
    saturated: int
    late: int
    torque_from: str
    torque: float
    deflection: float
    deflection_lsb: float
    torque_noise: float
    snr: float
    slower: tuple[Slower, ...] = ()
    highest: float = 0.0
    negative: float | None = None
    has_unused_rate: bool = False


_UNUSED_RATE = (
    "the recorded rate is not used: most such rates are filtered or rounded, which changes Bc. The derivative of the "
    "deflection takes its place, so Kc and Bc are not affected. Leave the column out"
)


def assess(recording: Recording, stretches: Sequence[Signals], defects: Defects) -> Quality:
    """Return the quality of a recording.

    stretches: all its signals, or some pieces of them. defects: the rows of the whole recording that are not used.
    """
    noise = float(np.median([_noise(stretch) for stretch in stretches]))
    dtheta = np.concatenate([stretch.motion.dtheta for stretch in stretches])
    torque = np.concatenate([stretch.as_read for stretch in stretches])
    variance = float(np.var(torque))
    saturated, late = _flagged(recording, Status.SATURATED, Status.LATE)
    stiffnesses = [negative_stiffness(stretch.motion, stretch.torque) for stretch in stretches]
    negative = [one for one in stiffnesses if one is not None]
    return Quality(
        samples=len(recording),
        defects=defects,
        saturated=saturated,
        late=late,
        torque_from=stretches[0].torque_from,
        torque=float(np.ptp(torque)),
        deflection=float(np.ptp(dtheta)),
        deflection_lsb=_count(stretches[0], dtheta),
        torque_noise=noise,
        # a torque that never changes in the samples is below any noise
        snr=10.0 * float(np.log10(max(variance, 1e-300) / noise**2)) if noise > 0.0 else float("inf"),
        slower=stretches[0].slower,
        highest=max(stretch.band[1] for stretch in stretches),
        has_unused_rate=_has_unused_rate(recording),
        negative=negative[0] if len(negative) == len(stretches) else None,
    )


def recording_diagnostics(recording: Recording, quality: Quality, limits: LimitsTable | None) -> list[Diagnostic]:
    """Return the warnings and errors about one recording, equal for `hil inspect` and `hil identify`.

    limits: the limits of the stand that the recording was made on, None if unknown.
    """
    imported = recording.imported
    by_position = quality.torque_from == "motor" and recording.profile.get("mode") == "position"
    return [
        *([] if quality.negative is None else [wrong_sign(quality.negative, imported=imported)]),
        *_unfinished(recording),
        *_unused_rows(quality, imported=imported),
        *_wrong_torques(quality.defects, quality.samples),
        *_unknown_rates(quality.defects, quality.samples, imported=imported),
        *([driven_by_position(is_error=True, imported=imported)] if by_position else []),
        *_weaknesses(quality, imported=imported),
        *(_slow(one, quality.highest, imported=imported) for one in quality.slower),
        *([Diagnostic("unused-rate", _UNUSED_RATE)] if quality.has_unused_rate else []),
        *unit_diagnostics(_swing(quality.torque), _swing(quality.deflection), limits),
        *lateness(quality.late, quality.samples),
    ]


def _has_unused_rate(recording: Recording) -> bool:
    """Return whether the table has a rate. A recorder computes one from the motor's position, for the limits alone."""
    rate, position = (recording.channel(name, 0, c.ENOUGH) for name in ("dtheta_dot", "motor_position"))
    return bool(np.isfinite(rate).any() and not np.isfinite(position).any())


def _swing(peak_to_peak: float) -> Swing:
    return Swing(-peak_to_peak / 2.0, peak_to_peak / 2.0)


def _unfinished(recording: Recording) -> list[Diagnostic]:
    if recording.complete:
        return []
    why = str(recording.attributes.get("end_reason", "")) or "it never ended"
    damage = recording.damage and f"; {recording.damage}"
    text = f"{recording.name} is not a complete run ({why}): its {len(recording)} rows are used{damage}"
    return [Diagnostic("unfinished", text)]


def _unused_rows(quality: Quality, *, imported: bool) -> list[Diagnostic]:
    defects, rows, found = quality.defects, quality.samples, []
    if defects.lost > c.LOST_ROWS * rows:
        lost = (
            f"{defects.lost} of {rows} replies were lost and are left out. Check cable and baud rate; hil doctor shows "
            "how often replies are lost"
        )
        found.append(Diagnostic("lost-samples", lost))
    if defects.not_numbers:
        numbers = (
            f"{defects.not_numbers} of {rows} rows hold no number, or one beyond {LARGEST:g}, and are left out: hil "
            "export shows which"
        )
        found.append(Diagnostic("invalid-readings", numbers))
    if defects.frozen:
        text = (
            f"the deflection stood still in {defects.frozen} of {rows} rows while the torque changed. These rows are "
            "left out; Kc and Bc come from the other rows. Check the encoder and its cable"
        )
        found.append(Diagnostic("invalid-readings", text))
    if defects.clipped:
        softer = again("Drive with less torque", "--amplitude", imported=imported)
        text = (
            f"the torque is at the end of its sensor's range in {defects.clipped} of {rows} rows. These rows are left "
            f"out; Kc and Bc come from the other rows. {softer}, or "
            "widen the sensor's range"
        )
        found.append(Diagnostic("invalid-readings", text))
    if defects.spikes:
        text = (
            f"the deflection of {defects.spikes} of {rows} rows is far from the readings before and after. These rows "
            "are left out. Check the encoder's cable"
        )
        found.append(Diagnostic("invalid-readings", text))
    if defects.wraps:
        text = (
            f"the deflection jumps {defects.wraps} times by the range of its encoder. The jumps are removed, so Kc and "
            "Bc are not affected. Set the encoder's zero so that the joint does not pass it"
        )
        found.append(Diagnostic("angle-wrapped", text))
    return found


def _wrong_torques(defects: Defects, rows: int) -> list[Diagnostic]:
    """Return the warnings about single wrong readings of the torque, and about changes of a zero."""
    found = []
    if defects.wrong_torques:
        value, times = Counter(defects.wrong_torques).most_common(1)[0]
        often = f", {value:.6g} N m in {times} of them," if times > 1 else ""
        text = (
            f"the torque of {len(defects.wrong_torques)} of {rows} rows{often} is far from the readings before and "
            "after, while the joint moved on. These rows are left out; Kc and Bc come from the other rows. Such a "
            "value often stands for a failed read: check the cable of the torque sensor, and the logger"
        )
        found.append(Diagnostic("invalid-readings", text))
    if stuck := defects.stuck_torques:
        text = (
            f"the torque of {len(stuck)} of {rows} rows, from {stuck[0]:.6g} s to {stuck[-1]:.6g} s, is constant while "
            "the joint moved on. These rows are left out; Kc and Bc come from the other rows. Check the torque sensor, "
            "its cable, and the logger"
        )
        found.append(Diagnostic("invalid-readings", text))
    if defects.zero_steps:
        steps = [
            f"the zero of the {channel} changes by {1e3 * size:.3g} {'mN m' if channel == 'torque' else 'mrad'} at "
            f"{time:.6g} s"
            for channel, _, time, size in defects.zero_steps
        ]
        text = (
            f"{'; '.join(steps)}, as after a tare or a restart. The change is subtracted, so Kc and Bc hold for all "
            "rows. To check them, identify the rows before and after it alone, with --from and --to"
        )
        found.append(Diagnostic("invalid-readings", text))
    return found


def _unknown_rates(defects: Defects, rows: int, *, imported: bool) -> list[Diagnostic]:
    found = []
    if defects.near_gaps:
        gaps = (
            f"{defects.near_gaps} rows beside a gap lack rate or acceleration and are not used: record without a pause"
        )
        found.append(Diagnostic("unknown-rate", gaps))
    if defects.jerked > c.MANY * rows:
        smoother = again(
            "Drive a multisine or a chirp, or read the sensors more often", "--profile, --rate", imported=imported
        )
        text = (
            f"the acceleration jumps beside {defects.jerked} of {rows} rows, so their rate or acceleration is not "
            f"known. These rows are left out; Kc and Bc come from the other rows. {smoother}"
        )
        found.append(Diagnostic("unknown-rate", text))
    if defects.coarse_clock:
        found.append(
            Diagnostic(
                "coarse-clock",
                "several rows share a time stamp or arrived together. Their times are spread evenly up to the next "
                "stamp, so Bc is less certain. Record with a finer clock, or record the time of each reading",
            )
        )
    return found


def _weaknesses(quality: Quality, *, imported: bool) -> list[Diagnostic]:
    larger = again("record a larger motion", "--amplitude", imported=imported)
    counts, found = quality.deflection / quality.deflection_lsb, []
    saturated = quality.saturated / quality.samples
    if saturated > c.LOST_ROWS:
        softer = again("drive with less torque", "--amplitude", imported=imported)
        text = f"the torque limit cut the command in {saturated:.1%} of the rows: {softer}"
        found.append(Diagnostic("saturated", text))
    if counts < c.FEW_COUNTS:
        text = f"the deflection spans {counts:.0f} counts of the encoder: {larger}"
        found.append(Diagnostic("deflection-noise", text, is_error=counts < 3.0))
    if quality.snr < c.POOR_SNR:
        text = f"the torque is only {quality.snr:.0f} dB above its noise: {larger}"
        found.append(Diagnostic("poor-snr", text, is_error=quality.snr < 3.0))
    return found


def _slow(one: Slower, highest: float, *, imported: bool) -> Diagnostic:
    shown = "each repeated until the next" if one.kind == "held" else "joined by straight lines"
    text = (
        f"the sensor of the {one.channel} has {1.0 / one.step:.3g} readings a second, {shown}, and the recording has "
        f"{1.0 / one.tick:.3g} rows a second"
    )
    if one.channel == "deflection" and highest * one.step > c.SPARSE:
        return Diagnostic(
            "slow-sensor",
            f"{text}. The joint moves at up to {highest:.3g} Hz, too fast for these readings, so Kc and Bc are wrong. "
            f"Read the encoder more often, or {again('move the joint more slowly', '--band', imported=imported)}",
            is_error=True,
        )
    text += ". Only the sensor's own readings are used"
    if one.unsure > c.TICK_SHARE * one.tick:
        text += f". Their age is known to {1e3 * one.unsure:.2g} ms, so Bc is less certain"
    if one.drifts > c.TICK_SHARE * one.tick:
        text += f". Their age may change by {1e3 * one.drifts:.2g} ms during the recording, so Bc is less certain"
    text += ". Record the sensor's own readings with its own time stamps"
    return Diagnostic("slow-sensor", text, "Bc")


def _flagged(recording: Recording, *flags: Status) -> list[int]:
    """Return the number of rows with each of the flags: saturated and late."""
    counts = [0] * len(flags)
    for start in range(0, len(recording), c.ENOUGH):
        status = recording.channel("status", start, start + c.ENOUGH).astype(np.int64)
        counts = [count + int(np.count_nonzero(status & int(flag))) for count, flag in zip(counts, flags, strict=True)]
    return counts


def _noise(signals: Signals) -> float:
    """Return the standard deviation of the torque, N m, about a local polynomial up to the excited band; robust to
    outliers.
    """
    time = signals.motion.time
    cycles = signals.band[1] * mean_step(time)
    if cycles > c.SPARSE:
        return _noise_beside_motion(signals)
    half = widest(0, cycles, max(2, (len(time) - 1) // c.WINDOWS), c.GAIN_ERROR)
    residual = signals.as_read - local_polynomial(time, signals.as_read, half, 0)
    # a window across a pause gives no value
    return c.SPREAD * float(np.nanmedian(np.abs(residual))) / float(np.sqrt(1.0 - kernel(half, 0)[half]))


def _noise_beside_motion(signals: Signals) -> float:
    """Return the standard deviation of the torque, N m, about a fitted spring and damper; robust to outliers."""
    motion = signals.motion
    columns = np.stack([motion.dtheta, motion.dtheta_dot, motion.dtheta_ddot, np.ones(len(motion))], axis=1)
    residual = signals.as_read - columns @ np.linalg.lstsq(columns, signals.as_read, rcond=None)[0]
    return c.SPREAD * float(np.median(np.abs(residual)))


def _count(stretch: Signals, dtheta: Array) -> float:
    """Return the smallest step between two readings of the deflection, rad, without the effect of a low-pass or of
    resampling.
    """
    return smallest_step(dtheta) if stretch.window is None else stretch.window.count
