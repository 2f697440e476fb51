"""What every channel of a log holds, looked at before anything is compared.

A channel is one sensor's samples. Some samples say something else than their sensor measured: the
angle of a joint jumps by a turn, a driver never fills a rate, a value is held or interpolated
between two measurements, or a sensor is at the end of its scale. What can be made good is made
good, the rest is left out, and the table of channels says which; so no comparison and no estimator
takes it for motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError, listed
from cpid_drake.logs.log import Log, Samples, turns
from cpid_drake.logs.noise_estimation import FEWEST, RESOLUTION, noise_level, rounding
from cpid_drake.logs.screening import as_arrays, is_later
from cpid_drake.logs.unwrapping import unwrapped
from cpid_drake.sensors.sensors import POSITIONS, SENSORS
from cpid_drake.spacecraft.spacecraft import Spacecraft

_SHOWS = 0.02  # smallest change that contradicts a constant [rad, m]
_AT_END = 4  # equal samples in a row at the end of a scale
_FASTEST = 2.0  # usual step of a wheel from which turns between samples may be missed [rad]


@dataclass(frozen=True)
class Channel:
    """One line of the table of channels.

    Attributes:
        name: of the sensor.
        rows: number of its samples.
        rate: their usual rate [Hz]; 0 for fewer than two samples.
        gap: length and start [s] of the longest gap of more than three usual steps; None without.
        notes: what was found in it, in words; empty if it is all right.
        is_used: whether it is used.

    """

    name: str
    rows: int
    rate: float
    gap: tuple[float, float] | None
    notes: tuple[str, ...]
    is_used: bool

    @property
    def cells(self) -> tuple[str, ...]:
        """Channel, rows, rate, gap, use and findings, in words."""
        gap = f"{self.gap[0]:.4g} s at {self.gap[1]:.6g} s" if self.gap else "-"
        use = "used" if self.is_used else "left out" if self.rows else "none"
        rate = f"{self.rate:.4g} Hz" if self.rate else "-"
        notes = "; ".join(self.notes) or "-"
        return SENSORS[self.name].quantity, str(self.rows), rate, gap, use, notes


def look_at(log: Log, spacecraft: Spacecraft | None = None) -> "ChannelReview":
    """Look at every channel of a log, and return what of it is used.

    Args:
        log: the samples as read; values need not be finite.
        spacecraft: the spacecraft model, of which joints slide, and the angles of some have no
            effect; None if it is not known.

    Raises:
        InputError: samples are not numbers, or their shapes do not match the sensor.

    """
    log, rotors, sliding = as_arrays(log), set[str](), set[str]()
    if spacecraft is not None:
        names, tree = spacecraft.joint_names, spacecraft.tree
        rotors = {name for k, name in enumerate(names) if tree.is_rotor(k)}
        sliding = {names[k] for k in tree.sliding}
    looked = ChannelReview(log, rotors, sliding)
    for name in ("attitude", "gyro", "position", "velocity"):
        looked.leave_out_copies(name)
    looked.unwrap()
    looked.leave_out_constants()
    for name in POSITIONS:
        looked.leave_out_ends(name)
    looked.table = tuple(
        _channel(name, looked.log[name], notes_of_channel, name in looked.out)
        for name, notes_of_channel in looked.notes.items()
    )
    kept = {name: s for name, s in looked.log.samples.items() if name not in looked.out}
    notes = {
        name: tuple(notes_of_channel)
        for name, notes_of_channel in looked.notes.items()
        if notes_of_channel
    }
    looked.log = replace(looked.log, samples=kept, motion={}, notes=notes)
    return looked


class ChannelReview:
    """A log after, or while, its channels are looked at.

    Attributes:
        log: what is used.
        notes: what was found, by channel, in words.
        out: channels that are left out.
        errors: what makes the log unusable, with the remedies.
        table: all channels.

    """

    def __init__(self, log: Log, rotors: set[str], sliding: set[str]) -> None:
        self.log, self._rotors, self._sliding = log, rotors, sliding
        self.notes = {n: [*log.notes.get(n, ()), *_repeated(s.time)] for n, s in log.items()}
        self.out, self.errors = set[str](), list[str]()
        self.table: tuple[Channel, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was found, by channel."""
        return tuple(
            f"{SENSORS[name].quantity}: {'; '.join(notes)}"
            for name, notes in self.notes.items()
            if notes
        )

    @property
    def not_compared(self) -> tuple[str, ...]:
        """The comparisons of which a side is left out."""
        return tuple(
            f"{SENSORS[position].quantity} with {SENSORS[rate].quantity} "
            f"({SENSORS[rate if rate in self.out else position].quantity} left out)"
            for rate, position in POSITIONS.items()
            if self.out & {rate, position}
        )

    def given(self, name: str) -> Samples | None:
        """Return the finite samples of a channel in the order of time; None for too few."""
        if name in self.out or name not in self.log.samples:
            return None
        samples = self.log[name].where(_usable(self.log[name]))
        return samples if len(samples) >= FEWEST and samples.value.shape[1] else None

    def keep(self, name: str, times: Array) -> None:
        """Keep the samples of a channel at some of its times."""
        samples = self.log[name]
        self.log = self.log.updated({name: samples.where(np.isin(samples.time, times))})

    def leave_out(self, name: str, why: str) -> None:
        """Leave out a channel."""
        self.notes[name].append(f"{why}, left out")
        self.out.add(name)

    # -- copies ----------------------------------------------------------------------------------

    def leave_out_copies(self, name: str) -> None:
        """Leave out samples that hold or interpolate others: they are no measurements."""
        given = self.given(name)
        if given is None or not _changes(given.value).any():
            return
        value = given.value[:, _changes(given.value)]
        step, bound = rounding(value), 1e-12 * np.abs(value).max()
        bend = np.abs(np.diff(value, n=2, axis=0)).max(axis=1)
        for word, new in (
            ("repeats", np.append(True, (np.diff(value, axis=0) != 0).any(axis=1))),
            ("interpolates", np.concatenate([[True], bend > max(4 * step, bound), [True]])),
        ):
            rows = np.flatnonzero(new)
            runs = np.diff(rows)
            usual = int(np.median(runs)) if runs.size >= FEWEST else 1
            if usual < 2 or np.quantile(np.abs(runs - usual), 0.9) > 1:  # equal by chance, not held
                continue
            if _noise(given.where(rows)) > 2 * step:
                text = f"{word} each value over {usual} rows: {len(new) - len(rows)} rows left out"
                self.notes[name].append(text)
                self.keep(name, given.time[rows])
                return

    # -- jumps by a turn -------------------------------------------------------------------------

    def unwrap(self) -> None:
        """Remove jumps by whole turns from the positions of joints."""
        given, rates = self.given("encoders"), self.given("joint_rates")
        if given is None:
            return
        value, changed = given.value.copy(), []
        for k, joint in enumerate(self.log.joint_names):
            turned = np.zeros(len(given))
            if rates is not None and np.isfinite(rates.value[:, k]).all():
                integral = cumulative_trapezoid(rates.value[:, k], rates.time, initial=0.0)
                turned = np.interp(given.time, rates.time, integral)
            if joint in self._sliding:
                continue
            new, count = unwrapped(value[:, k], turned)
            if count:
                changed.append(f"{joint} ({count} jump{'s' * (count > 1)})")
                value[:, k] = new
            steps = np.abs(np.diff(new)) if count else np.zeros(1)
            if not turned.any() and np.median(steps) > _FASTEST:
                self.errors.append(
                    f"q:{joint} turns by {np.median(steps):.2g} rad between samples, and is given "
                    f"within one turn: its speed cannot be known; give its rates, qd:{joint}"
                )
        if changed:
            self.notes["encoders"].append(f"wrapped by whole turns, unwrapped: {listed(changed)}")
            self._replace_positions(value)

    # -- constants -------------------------------------------------------------------------------

    def leave_out_constants(self) -> None:
        """Leave out channels that are exactly constant while others show that they change."""
        for rate, position in POSITIONS.items():
            self._check_rate(rate, position)
            self._check_position(rate, position)
        attitude, moving = self.given("attitude"), self._moving_joints()
        if attitude is None or _changes(attitude.value).any() or not moving:
            return
        text = f"constant while {listed(moving)} moved"
        others = [each for each in map(self.given, ("position", "velocity", "gyro")) if each]
        if any(_noise(each) > RESOLUTION * np.ptp(each.value) for each in others):
            self.errors.append(
                f"attitude: {text}: it is not filled, and nothing gives the base's rotation"
            )
        self.notes["attitude"].append(text)

    def _moving_joints(self) -> list[str]:
        """Return the joints, except wheels, that move."""
        given = self.given("encoders")
        if given is None:
            return []
        moved = np.ptp(given.value, axis=0) > _SHOWS
        names = zip(self.log.joint_names, moved, strict=True)
        return [joint for joint, moves in names if moves and joint not in self._rotors]

    def _check_rate(self, rate: str, position: str) -> None:
        """Leave out a rate of which an entry is constant while the position changes otherwise."""
        given, moved = self.given(rate), self.given(position)
        if given is None:
            return
        constant = ~_changes(given.value)
        if not constant.any():
            return
        if moved is None:
            if constant.all() and rate != "joint_rates" and (moving := self._moving_joints()):
                self.leave_out(rate, f"constant while {listed(moving)} moved: not filled")
            return
        other = _path(position, moved) - given.value[0] * (moved.time - moved.time[0])[:, None]
        noise = _noise(moved)
        wrong = constant & (np.ptp(other, axis=0) > max(_SHOWS, 10 * noise))
        if wrong.any():
            names = self.log.joint_names if rate == "joint_rates" else "xyz"
            which = listed([names[k] for k in np.flatnonzero(wrong)])
            size = "zero" if not given.value[0, wrong].any() else "constant"
            what = SENSORS[position].quantity
            self.leave_out(rate, f"{size} in {which} while the {what} changed: not filled")

    def _check_position(self, rate: str, position: str) -> None:
        """Leave out a position that is constant while its rate, or the joints, move."""
        given, rates = self.given(position), self.given(rate)
        if given is None:
            return
        constant, moves = ~_changes(given.value), np.zeros(given.value.shape[1], dtype=bool)
        if rates is not None and constant.any():
            drift = rates.value - rates.value.mean(axis=0)
            path = cumulative_trapezoid(drift, rates.time, axis=0, initial=0.0)
            width = moves.size if position == "encoders" else 3
            moves[:width] = np.ptp(path, axis=0)[: moves.size] > _SHOWS
        if position == "encoders":
            self._check_joints(given, constant & moves)
        elif constant.all() and moves.any():
            self.leave_out(
                position, f"constant while the {SENSORS[rate].quantity} changed: not filled"
            )
        elif position == "position" and constant.all() and (moving := self._moving_joints()):
            self.leave_out(position, f"constant while {listed(moving)} moved: not filled")

    def _check_joints(self, given: Samples, wrong: NDArray[np.bool_]) -> None:
        value = given.value.copy()
        for k in np.flatnonzero(wrong).tolist():
            joint = self.log.joint_names[k]
            text = f"q:{joint} is constant while qd:{joint} shows motion: it is not filled"
            if joint in self._rotors:
                value[:, k] = np.nan
                self.notes["encoders"].append(f"{text}; the integral of qd:{joint} is used")
            else:
                self.errors.append(f"{text}; give its positions")
        if np.isnan(value).any():
            self._replace_positions(value)

    def _replace_positions(self, value: Array) -> None:
        """Replace the given positions of joints; others, which screening rejects, stay."""
        samples = self.log.encoders
        new = samples.value.copy()
        new[_usable(samples)] = value
        self.log = self.log.updated({"encoders": Samples(samples.time, new)})

    # -- ends of scale ---------------------------------------------------------------------------

    def leave_out_ends(self, name: str) -> None:
        """Leave out samples at the end of a sensor's scale."""
        given = self.given(name)
        if given is None:
            return
        at_end, ends = np.zeros(len(given), dtype=bool), list[str]()
        for column in given.value.T:
            for end in (column.max(), column.min()):
                same = column == end
                edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
                longest = int(np.max(edges[1::2] - edges[::2], initial=0))
                others = column[~same]
                if longest < _AT_END or end == 0 or len(others) < FEWEST:
                    continue
                if len(np.unique(others)) < 0.5 * len(others):  # in coarse steps
                    continue
                noise = _noise(Samples(given.time[~same], others[:, None]))
                if noise > 1e-4 * np.ptp(column):
                    at_end |= same
                    ends.append(f"{end:.4g}")
        if at_end.any() and not at_end.all():
            text = f"{at_end.sum()} rows at the end of the scale ({listed(ends)}), left out"
            self.notes[name].append(text)
            self.keep(name, given.time[~at_end])


def _repeated(time: Array) -> list[str]:
    """Return a note if samples repeat stamps: screening leaves them out, and counts them."""
    time = time[np.isfinite(time)]
    count = len(time) - len(np.unique(time))
    return [f"{count} with a repeated stamp, left out: the first counts"] if count else []


def _usable(samples: Samples) -> NDArray[np.bool_]:
    """Return which samples are finite, and in the order of time; an entry may always be absent."""
    is_number = np.isfinite(samples.value) | np.isnan(samples.value).all(axis=0)
    usable = is_number.all(axis=1) & np.isfinite(samples.time)
    return usable & is_later(np.where(usable, samples.time, np.nan))


def _changes(value: Array) -> NDArray[np.bool_]:
    """Return which entries (width,) of values are not exactly constant; absent ones are not."""
    return np.asarray((value != value[0]).any(axis=0))


def _noise(samples: Samples) -> float:
    """Return the noise of the finite entries; 0 if it cannot be estimated."""
    value = samples.value[:, np.isfinite(samples.value).all(axis=0)]
    try:
        return noise_level(Samples(samples.time, value)) if value.size else 0.0
    except InputError:
        return 0.0


def _path(name: str, samples: Samples) -> Array:
    """Return what the rate of a channel sums up to: for the attitude, the turn in B."""
    if name != "attitude":
        return samples.value
    still = np.where(samples.value.any(axis=1, keepdims=True), samples.value, [1.0, 0, 0, 0])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(turns(still), axis=0)])


def _channel(name: str, samples: Samples, notes: Sequence[str], is_out: bool) -> Channel:
    """Return the line of a channel."""
    time = samples.time[is_later(samples.time)]
    rate, gap, steps = 0.0, None, np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    if usual > 0:
        rate, k = 1 / usual, int(steps.argmax())
        gap = (float(steps[k]), float(time[k])) if steps[k] > 3 * usual else None
    rows = len(samples) if samples.value.shape[1] else 0
    return Channel(name, rows, rate, gap, tuple(notes), rows > 0 and not is_out)
