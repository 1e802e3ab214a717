"""What would explain a part of what an estimate leaves, and what was found with the coefficients: errors of sensors,
random forces, noise, missing terms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, Final

import numpy as np

from linkwise.display import format_error, format_percent
from linkwise.model.coefficient import MASS
from linkwise.model.host import in_words, is_between_modes
from linkwise.records.record import Record
from linkwise.registry import Registry

DEGREES = float(np.degrees(1.0))
"""By which an angle in deg is too large where it is taken for one in rad."""


@dataclass(frozen=True)
class Cause:
    """An error that would explain a part of what a fit leaves.

    Attributes
    ----------
    kind : str
        ``"gain"``, ``"offset"``, ``"drift"``, ``"delay"`` or ``"crosstalk"`` of a channel, a ``"filter"`` that all of them
        share, the wrong ``"sign"`` of a channel, a ``"unit"`` that is another one, two channels that are ``"swapped"``,
        another ``"place"`` of a force, ``"relative"`` motion taken for absolute, a ``"high pass"``, a ``"clock"``, a
        ``"slip"`` by samples that were lost or doubled, a ``"gain drift"`` of a channel or all of them, a ``"nonlinearity"``
        of a channel, ``"clipped"`` samples, ``"hits"`` of few, ``"spikes"``, a ``"hum"``, an exponential ``"window"``,
        ``"mass"``, the ``"frequency"`` of a mode of a host or its ``"shape"`` at a point, a ``"mode"`` or ``"damping between
        modes"`` that a host lacks, ``"force gain"`` or ``"force delay"`` of an applied force, ``"input noise"`` of its channel
        or that of the base, an ``"ambient"`` or ``"harmonic force"`` on a mass, one that is a ``"coloured force"`` where white
        ones were assumed, ``"correlated forces"`` on two masses, an ``"unsteady force"`` whose level changes with time, a
        ``"change"`` of a coefficient at one moment, an ``"event"`` that no input shows, a missing ``"term"`` of a link, a
        missing ``"link"`` between two masses or to the ground, or a stated value, ``"prior"``, that the records contradict.
    where : str
        The channel, mass or link; of a missing link the two that it joins, ``"m2-ground"``.
    size : float
        The error, in `unit`: relative for gains, masses and frequencies, of a force what acts over what its channel
        shows, its delay behind that, the root mean square of the force for a term or a link, half the square of the
        time constant for a filter, how many times too large values in another unit are, what a gain drifts by, the
        corner of a high pass, the frequency of a mode that is lacking or of a hum, the rate at which a window falls,
        the number of clipped samples or spikes, of samples of the shortest hit, of those that were lost or, below 0,
        doubled, 0 for a sign, a relative motion and channels that are swapped, the standard deviation of noise, the
        spectral density of an ambient force, the root mean square of what that of a coloured one departs from its mean
        by, and the square of that of an unsteady one, the correlation of two forces, what a coefficient changes by.
    unit : str
        SI unit of `size`, ``"1"`` for a ratio.
    gain : float
        What it would take off -2 log likelihood.
    standard_error : float
        Of `size`; 0 for errors of a whole channel, whose size is no small one.
    term : str
        The form of a missing term, or of the law of a missing link, else empty.
    source : str
        The channel that crosstalk comes from, the other one of two that are swapped or correlated, the mass on which a force
        acts, the mode of a shape, or the moment of a change, a slip or an event, else empty.
    share : float
        Of a missing term: its part of the force in its link, both root mean squares; of an event: the part by
        which the motion grows there, 0 where that does not explain as much; of a mode that is lacking: the part of
        the power that is left in the sensors of its host that it explains.
    remark : str
        What else looks like it, else empty.
    shift : float
        The largest change of a coefficient that it would make, to first order, in standard errors of that coefficient.
    shifted : str
        The coefficient with this change.
    overturned : tuple of str
        The coefficients that differ from zero by more than two standard errors, and beside it would not, or have the other
        sign.
    rivals : tuple of str
        What else the records hardly distinguish from it, with which a coefficient would change otherwise: the `name` of each.
    known_within : float
        Where it is open which of several is off: the relative standard deviation that each of them is taken as known to.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> values = record.values.copy()
    >>> values[:, record.channels.index("x:m2")] *= 1.05
    >>> wrong = lw.Record(record.start, record.rate, record.channels, values)
    >>> fit = lw.identify(wrong, chain.unknown("nes"), as_stated=True)
    >>> fit.diagnosis[0].kind, fit.diagnosis[0].where
    ('gain', 'x:m2')
    """

    kind: str
    where: str
    size: float
    unit: str
    gain: float
    standard_error: float
    term: str = ""
    source: str = ""
    share: float = 0.0
    remark: str = ""
    shift: float = 0.0
    shifted: str = ""
    overturned: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    known_within: float = 0.0

    @property
    def name(self) -> str:
        """What it is and where, without its size."""
        return f"{self.term or self.kind} of {self.where}" + (f" from {self.source}" if self.source else "")

    @property
    def is_instrument(self) -> bool:
        """Whether it lies in what was recorded or stated, not in a law."""
        return self.kind not in ("term", "link")

    @property
    def label(self) -> str:
        """What it is, without its size where it is a term or a link."""
        if self.is_instrument:
            return self.description
        return f"{self.term} in {'a link ' if self.kind == 'link' else ''}{self.where}"

    @property
    def description(self) -> str:
        """In words, with its size."""
        size, number = abs(self.size), 0 if self.size > 0.0 else 1
        open_ = f"which one is off is open: each is taken as {self.known_to}" if self.known_within else ""
        remark = self.remark or open_
        return CAUSE_KINDS.lookup(self.kind).text.format(
            self,
            size=size,
            percent=100.0 * self.size,
            size_percent=100.0 * size,
            ms=1e3 * self.size,
            size_ms=1e3 * size,
            plural="" if size == 1.0 else "s",
            remark=f" ({remark})" if remark else "",
            larger=("larger", "smaller")[number],
            later=("later", "earlier")[number],
            above=("above", "below")[number],
            faster=("fast", "slow")[number],
            lost=("lost", "doubled")[number],
        )

    @property
    def asked(self) -> str:
        """What asks for it as an unknown: the option of a line, else where it is."""
        options = {
            HUM: "--sensor {0.where}:hum={0.size:.6g}Hz",
            HARMONIC: "--harmonic {0.where}={0.size:.6g}Hz",
        }
        return options.get(self.kind, "{0.where} unknown").format(self)

    @property
    def known_to(self) -> str:
        """How well each of several is known of which one is off."""
        return f"known to within {format_percent(self.known_within)}"

    @property
    def _corner(self) -> float:
        """Hz of the low pass of first order that delays and weakens as much."""
        return float(1.0 / (2.0 * np.pi * np.sqrt(2.0 * abs(self.size))))

    @property
    def _modes(self) -> str:
        return in_words(self.where)

    @property
    def _times(self) -> str:
        """By how much values in another unit are wrong, with an example."""
        large = self.size >= 1.0
        times = f"{self.size if large else 1.0 / self.size:g}"
        examples = {f"{1000.0:g}": ", as mm taken for m", f"{DEGREES:g}": ", as deg taken for rad"}
        example = examples.get(times, "") if large and self.where.startswith("x:") else ""
        return f"{times} times too {'large' if large else 'small'}{example}"

    def to_dict(self) -> dict[str, str | float | list[str]]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        return {
            **({"source": self.source} if self.source else {}),
            **({"rivals": [*self.rivals]} if self.rivals else {}),
            "cause": self.kind if not self.term else f"term {self.term}",
            "where": self.where,
            "size": self.size,
            "unit": self.unit,
            "gain": self.gain,
            "message": f"{self.description} would lower -2 log likelihood by {self.gain:.3g}",
        }


@dataclass(frozen=True)
class CauseKind:
    """A kind of cause: its description, a template (see `Cause.description`), the `unit` of its size, "" for that of its
    channel, and whether it is `relative`.

    A relative size is that of an error of a calibration, which is small where the first order holds.
    """

    text: str
    unit: str = ""
    relative: bool = False


HIGH_PASS: Final = "high pass"
CLOCK: Final = "clock"
CROSSTALK: Final = "crosstalk"
SLIP: Final = "slip"
EVENT: Final = "event"
AMBIENT: Final = "ambient"
HARMONIC: Final = "harmonic force"
CLIPPED: Final = "clipped"
HITS: Final = "hits"
SPIKES: Final = "spikes"
HUM: Final = "hum"
WINDOW: Final = "window"
GAIN_DRIFT: Final = "gain drift"
NONLINEARITY: Final = "nonlinearity"

_OFF = "{0.where} that is off by {percent:+.3g} %"
_SIZED = "{0.where} of {size:.3g} {0.unit}{remark}"

CAUSE_KINDS: Registry[CauseKind] = Registry(
    "kind of cause",
    {
        "gain": CauseKind(f"a gain of {_OFF}{{remark}}", "1", relative=True),
        GAIN_DRIFT: CauseKind("a gain of {0.where} that drifts by {percent:+.3g} %", "1", relative=True),
        NONLINEARITY: CauseKind(
            "a sensor of {0.where} that shows {percent:+.3g} % more than in proportion at its largest value",
            "1",
            relative=True,
        ),
        "offset": CauseKind("an offset of {0.size:.3g} {0.unit} in {0.where}"),
        "drift": CauseKind("a drift of {0.size:.3g} {0.unit} in {0.where}"),
        "delay": CauseKind("a delay of {ms:.3g} ms in {0.where}{remark}", "s"),
        CROSSTALK: CauseKind("{percent:+.3g} % of {0.source} in {0.where}", "1", relative=True),
        "filter": CauseKind(
            "a filter of {0.where}, as a low pass of first order at {0._corner:.3g} Hz{remark}", "s^2"
        ),
        "sign": CauseKind("the wrong sign of {0.where}{remark}", "1"),
        "unit": CauseKind("another unit of {0.where}, values {0._times}", "1"),
        "swapped": CauseKind("{0.where} and {0.source} in each other's place", "1"),
        "place": CauseKind("{0.where} that acts on {0.source}", "1"),
        "relative": CauseKind("{0.where} that shows motion relative to the base", "1"),
        HIGH_PASS: CauseKind("a high pass of {0.where} at {0.size:.3g} Hz, as AC coupling is", "Hz"),
        CLOCK: CauseKind("a clock of {0.where} that runs {size:.3g} ppm {faster}{remark}", "ppm"),
        SLIP: CauseKind("{0.where} that {lost} {size:.0f} sample{plural} at {0.source}", "1"),
        CLIPPED: CauseKind("{0.size:.0f} clipped sample{plural} of {0.where}", "1"),
        HITS: CauseKind("gaps at hits of {0.where} whose {size:.0f} samples do not tell their force", "1"),
        SPIKES: CauseKind("{0.size:.0f} sample{plural} of {0.where} that are spikes", "1"),
        HUM: CauseKind("a hum of {0.where} at {0.size:.5g} Hz{remark}", "Hz"),
        WINDOW: CauseKind("an exponential window on {0.where} that falls by {0.size:.3g} 1/s", "1/s"),
        "mass": CauseKind(f"a mass of {_OFF}{{remark}}", "1", relative=True),
        "coefficient": CauseKind(_OFF, "1"),
        "frequency": CauseKind(f"a frequency of {_OFF}", "1"),
        "damping": CauseKind(f"a damping of {_OFF}", "1"),
        "damping between modes": CauseKind("damping of {0.size:.3g} {0.unit} {0._modes}", "N s/m"),
        "shape": CauseKind(f"a shape of {{0.source}} at {_OFF}", "1", relative=True),
        "mode": CauseKind("a mode near {0.size:.3g} Hz that the host {0.where} lacks", "Hz"),
        "force gain": CauseKind(
            "a force {size_percent:.3g} % {larger} than {0.where} shows{remark}", "1", relative=True
        ),
        "force delay": CauseKind("a force {size_ms:.3g} ms {later} than {0.where} shows{remark}", "s"),
        "input noise": CauseKind(f"noise of {_SIZED}"),
        AMBIENT: CauseKind(f"an ambient force on {_SIZED}"),
        HARMONIC: CauseKind(
            "a harmonic force of {0.size:.3g} Hz on {0.where} ({0.source}) that was not recorded{remark}; try "
            "--harmonic {0.where}={0.size:.4g}Hz",
            "Hz",
        ),
        "coloured force": CauseKind("an ambient force on {0.where} that is not white{remark}", "1"),
        "correlated forces": CauseKind(
            "a correlation of {0.size:.2g} between the ambient forces on {0.where} and {0.source}", "1"
        ),
        "unsteady force": CauseKind(
            "an ambient force on {0.where} whose level changes with time{remark}", "1"
        ),
        "change": CauseKind("a change of {0.where} by {0.size:+.3g} {0.unit} near {0.source}{remark}"),
        EVENT: CauseKind(
            "a force that was not recorded, such as a hit, or a fault of a sensor, {0.source}{remark}", "s"
        ),
        "prior": CauseKind(
            "{0.where} {size:.3g} {0.unit} {above} the value that is stated with a sigma of {0.standard_error:.3g}"
        ),
        "term": CauseKind(f"a force like {{0.term}} in {_SIZED}"),
        "link": CauseKind("a link {0.where} with a force like {0.term} of {size:.3g} {0.unit}"),
    },
)
"""What a diagnosis may name."""

FOUND = {
    "offset": "is off by {0.value:.4g}{unit} throughout",
    "gain": "shows {0.value:.6g} of its {shown}",
    "delay": "is late by {ms:.4g} ms",
    HIGH_PASS: "is behind a high pass with its corner at {0.value:.4g} Hz",
    CLOCK: "has a clock that runs {size:.4g} ppm {faster}",
    GAIN_DRIFT: "has a gain that drifts by {0.value:.4g} of it",
    NONLINEARITY: "shows {0.value:.4g} more than in proportion at its largest value",
    CROSSTALK: "shows {0.value:.4g} of what {0.source} shows as well",
    HARMONIC: "has a harmonic force at {0.value:.6g} Hz that was not recorded",
}
"""What is said of a channel whose error of a kind is estimated with the laws (see `SensorErrorEstimate.description`)."""


_TOLD = 3  # coefficients, or masses; the others are listed
_OF_TERMS = "larger amplitudes, a longer record or less noise tell whether they lack such a term"
_OF_MASSES = (
    "weigh these masses to better than that, or state how well they are known, as { start = 0.01, sigma = 1e-4 }, which the "
    "intervals then include"
)
_OF_DRIFTS = (
    "where the motion decays such a drift passes for damping; let sensors and amplifiers warm, and calibrate them before and "
    "behind the record"
)


@dataclass(frozen=True)
class UnseenTerm:
    """A term that records of exact laws bound so loosely that it could move a coefficient out of its interval.

    Damping between two modes of a host that the host does not have is such a term as well, and so is the force of inertia of a
    mass that is off the stated one, and a gain of a sensor that drifts along the record.

    Attributes
    ----------
    link : str
        The link whose law may lack it; of damping between modes the one that would hold it, as ``"wing.mode1+mode2"``, and
        the mass where that may be off, and the channel whose gain may drift, ``"all channels"`` of all of them.
    term : str
        Its form, such as ``"d**5"``; ``"v"`` of damping between modes, ``"mass"`` of a mass, ``"gain drift"`` of a gain.
    share : float
        The largest part of the force in the link, by root mean squares, that it could make: the end of its 95 % interval that
        is farther from zero. Of damping between modes, the part of the largest that dissipates in every motion, the
        geometric mean of the damping of the two modes. Of a mass, the part of it by which it may be off, at most a fifth; of
        a gain, that by which it may drift along the record, at most a twentieth.
    coefficient : str
        The coefficient that a term of this size would change most, counted in standard errors.
    change : float
        That change if the term is added to the law, in the unit of the coefficient, to first order.
    standard_errors : float
        Its size in standard errors of the coefficient.
    relative_change : float
        Its size relative to the coefficient.

    Examples
    --------
    >>> import linkwise as lw
    >>> term = lw.estimates.UnseenTerm("s", "d**5", 0.004, "s.k3", change=-1.2e4, standard_errors=6.1, relative_change=0.03)
    >>> print(term.description)
    a force like d**5 in s of up to 0.4 % of the force there, which would change s.k3 by 3 % or 6.1 of its standard errors
    """

    link: str
    term: str
    share: float
    coefficient: str
    change: float
    standard_errors: float
    relative_change: float

    @property
    def description(self) -> str:
        """In words, with its sizes."""
        part = f"of up to {format_percent(self.share)}"
        change = (
            f"would change {self.coefficient} by {format_percent(self.relative_change)} or "
            f"{format_error(self.standard_errors)} of its standard errors"
        )
        if self.is_mass:
            return f"a mass of {self.link} that is off by up to {format_percent(self.share)}, which {change}"
        if self.is_drift:
            return f"a gain of {self.link} that drifts by up to {format_percent(self.share)}, which {change}"
        term = f"a force like {self.term} in {self.link} {part} of the force there"
        if is_between_modes(self.link):
            term = f"damping {in_words(self.link)} {part} of the largest that dissipates"
        return f"{term}, which {change}"

    @property
    def is_mass(self) -> bool:
        """Whether it is an error of a stated mass."""
        return self.term == MASS

    @property
    def is_drift(self) -> bool:
        """Whether it is a gain of a sensor that drifts."""
        return self.term == GAIN_DRIFT

    def to_dict(self) -> dict[str, str | float]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        return {
            "link": self.link,
            "term": self.term,
            "share_percent": 100.0 * self.share,
            "coefficient": self.coefficient,
            "change": self.change,
            "standard_errors": self.standard_errors,
            "message": self.description,
        }


def unseen_remark(terms: Sequence[UnseenTerm]) -> tuple[str, ...]:
    """What is told of `unseen_terms`: a sentence on terms, one on masses and one on sensors; nothing without any."""
    masses, drifts = [term for term in terms if term.is_mass], [term for term in terms if term.is_drift]
    laws = [term for term in terms if not (term.is_mass or term.is_drift)]
    return (
        *_remark(laws, "laws", "terms", _OF_TERMS),
        *_remark(masses, "masses", "masses", _OF_MASSES),
        *_remark(drifts, "sensors", "drifts", _OF_DRIFTS),
    )


def _remark(terms: Sequence[UnseenTerm], stated: str, kind: str, advice: str) -> tuple[str, ...]:
    """A sentence on the first ones that move different coefficients, or of different masses; none without any."""
    of_each: dict[str, UnseenTerm] = {}
    for term in terms:
        of_each.setdefault(term.link if term.is_mass else term.coefficient, term)
    if not terms:
        return ()
    first = list(of_each.values())[:_TOLD]
    more = f" In all, {len(terms)} such {kind} are listed in the result." if len(terms) > len(first) else ""
    return (
        f"The records do not rule out {'; '.join(term.description for term in first)}. The intervals hold for the {stated} as "
        f"stated: {advice}.{more}",
    )


@dataclass(frozen=True)
class SensorErrorEstimate:
    """A constant error of a sensor, its gain or its delay, found with the coefficients.

    Attributes
    ----------
    channel : str
        The channel.
    kind : {"offset", "gain", "delay", "high pass", "clock", "crosstalk", "harmonic force"}
        What it is: the sensor shows ``gain * motion(t - delay) + offset``, and the channel of a force that of a force.
    value, standard_error : float
        Its size and the standard error of that: of an offset in the SI unit of the channel, of a delay in s.
    unit : str
        That unit; 1 of a gain.
    source : str
        The channel that crosstalk comes from, else empty.

    Examples
    --------
    >>> import linkwise as lw
    >>> error = lw.estimates.SensorErrorEstimate("x:m1", "gain", value=1.02, standard_error=0.001, unit="1")
    >>> error.description
    'x:m1 shows 1.02 of its motion (estimated with the other unknowns, standard error 0.001).'
    """

    channel: str
    kind: str
    value: float
    standard_error: float
    unit: str
    source: str = ""

    @property
    def description(self) -> str:
        """In words, with its standard error."""
        kind = self.channel.partition(":")[0]
        shown = {"force": "force", "f": "force", "state": "value"}.get(kind, "motion")
        words = {"shown": shown, "unit": f" {self.unit}".replace("?", "").rstrip()}
        words["faster"] = "fast" if self.value > 0.0 else "slow"
        size = FOUND[self.kind].format(self, size=abs(self.value), ms=1e3 * self.value, **words)
        units = {"delay": (1e3, " ms"), CLOCK: (1.0, " ppm"), HARMONIC: (1.0, " Hz")}
        scale, unit = units.get(self.kind, (1.0, ""))
        error = f"{scale * self.standard_error:.2g}{unit}"
        return f"{self.channel} {size} (estimated with the other unknowns, standard error {error})."

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> SensorErrorEstimate:
        """Read what `to_dict` wrote.

        Parameters
        ----------
        document : mapping of str to object
            Its part of result.json.

        Returns
        -------
        SensorErrorEstimate
            The error.

        Raises
        ------
        KeyError, TypeError, ValueError
            If something is missing, of another type, or not finite.
        """
        channel, kind, unit = (str(document[name]) for name in ("channel", "kind", "unit"))
        value, error = float(document["value"]), float(document["standard_error"])
        if kind not in FOUND or not (isfinite(value) and 0.0 <= error < inf):
            raise ValueError(f"not an error of a sensor: {dict(document)}")
        return cls(channel, kind, value, error, unit, str(document.get("source", "")))

    def to_dict(self) -> dict[str, str | float]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        document = dict(vars(self))
        return document if self.source else {key: value for key, value in document.items() if key != "source"}


@dataclass(frozen=True)
class RandomForceEstimate:
    """A random force on a mass: an ambient one, or the noise of the channel of an applied force or of the base.

    Attributes
    ----------
    where : str
        The mass, or the channel.
    ambient : bool
        Whether it is an ambient force.
    deviation : float
        Standard deviation of samples of it at the rate of the first record, in its unit.
    spectral_density : float
        One-sided amplitude spectral density, in that unit over sqrt(Hz).
    found : bool
        Whether it was found; else it was stated.
    unit : str
        N of a force, N m of a moment, m or m/s^2 of a base.
    upper_limit : float or None
        Where the deviation was looked for and found to be zero, or not certainly above it: what it does not exceed, at 95 %;
        of an ambient force the spectral density. None for others.

    Examples
    --------
    >>> import linkwise as lw
    >>> force = lw.estimates.RandomForceEstimate("m1", True, deviation=2.0, spectral_density=0.4, found=True)
    >>> force.description
    'An ambient force on m1 of 0.4 N/sqrt(Hz), found with the other unknowns, is allowed for.'
    """

    where: str
    ambient: bool
    deviation: float
    spectral_density: float
    found: bool
    unit: str = "N"
    upper_limit: float | None = None

    @property
    def description(self) -> str:
        """In words, with its size."""
        origin = "found with the other unknowns" if self.found else "as stated"
        unit = f"{self.unit}/sqrt(Hz)" if self.ambient else self.unit
        limit = "" if self.upper_limit is None else f"is below {self.upper_limit:.2g} {unit} (95 %)"
        if limit and self.deviation == 0.0:
            kind = "ambient force on" if self.ambient else "noise of"
            return f"No {kind} {self.where} was found: it {limit}."
        size = self.spectral_density if self.ambient else self.deviation
        kind = "An ambient force on" if self.ambient else "Noise of"
        chance = f"; it may be chance, and {limit}" if limit else ""
        return f"{kind} {self.where} of {size:.3g} {unit}, {origin}, is allowed for{chance}."

    def to_dict(self) -> dict[str, str | float | bool | None]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        return {
            "where": self.where,
            "kind": "ambient" if self.ambient else "input noise",
            "deviation": self.deviation,
            "deviation_unit": self.unit,
            "spectral_density": self.spectral_density,
            "spectral_density_unit": f"{self.unit}/sqrt(Hz)",
            "found": self.found,
            "upper_limit": self.upper_limit,
        }


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise of a channel.

    Attributes
    ----------
    sigma : float
        Standard deviation in the SI unit of the channel.
    unit : str
        The unit.
    snr_db : float
        Signal-to-noise ratio in dB, of the mean square of the motion to that of the noise.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> noise = lw.identify(record, chain.unknown("nes"), method="weak").noise["x:m1"]
    >>> noise.unit, round(noise.snr_db)
    ('m', 40)
    """

    sigma: float
    unit: str
    snr_db: float

    @classmethod
    def of(cls, record: Record, name: str, sigma: float, unit: str = "") -> NoiseEstimate:
        """Noise of a channel of a record.

        Parameters
        ----------
        record : Record
            The record.
        name : str
            Name of the channel.
        sigma : float
            Standard deviation of the noise in its SI unit.
        unit : str, optional
            That unit, where it is not the one of the channel's kind: of a state of a link.

        Returns
        -------
        NoiseEstimate
            The noise.
        """
        power = float(np.nanmean(record.channel(name) ** 2))
        return cls.from_power(power, sigma, unit or record.unit(name))

    @classmethod
    def from_power(cls, power: float, sigma: float, unit: str) -> NoiseEstimate:
        """Noise of a channel of known mean square.

        Parameters
        ----------
        power : float
            Mean square of the samples, noise included.
        sigma : float
            Standard deviation of the noise in the SI unit of the channel.
        unit : str
            That unit.

        Returns
        -------
        NoiseEstimate
            The noise.
        """
        motion = max(0.0, power - sigma**2)
        with np.errstate(divide="ignore"):  # of noise alone
            ratio = float(10.0 * np.log10(motion / sigma**2)) if sigma > 0.0 else np.inf
        return cls(float(sigma), unit, ratio)
