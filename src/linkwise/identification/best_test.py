"""Which test determines a coefficient best: `limit` of hits, sweeps and multisines within limits of force and stroke."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from linkwise.analysis.linear_modes import natural_frequencies
from linkwise.arrays import Floats
from linkwise.display import JudgedView, align_columns, paragraph
from linkwise.errors import IdentificationError, SimulationError, StructureError, expect
from linkwise.identification.limit import SHORTEST, limit
from linkwise.identification.limit_result import Limit
from linkwise.model.excitation import Sampled, TimeFunction
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.simulation.simulate import simulate
from linkwise.verdict import UNGRADED, Basis, Verdict

# of the lowest mode: segments of this length compare tests, and not how chaotic their motion is
_PERIODS = 4.0
_MODES = 3  # of the lowest: each has a band of its own, beside the one of all
_BESIDE = 1.5  # of its frequency, to both sides
_LINES = 12  # of a multisine
_HALVINGS = 8  # of the largest force, until the stroke is within its limit
_SIZES = 3  # halvings from there on: a small motion may tell a linear term better
_REFINED = 3  # of the best tests, for which sensors are left out
_AS_GOOD = 1.1  # times the standard error with all sensors
_ROWS = 10


@dataclass(frozen=True, eq=False)
class Plan:
    """A test that is within the limits, and what it determines.

    Attributes
    ----------
    kind, place : str
        "hit", "sweep" or "multisine", and the mass or point that is driven.
    peak : float
        The largest force in N.
    band : tuple of two floats
        The frequencies in Hz that it excites.
    force : str
        The force as an expression of t.
    strokes : dict of str to float
        The largest elongation in m by link.
    limit : Limit
        What the test determines with its sensors.

    Examples
    --------
    >>> import linkwise as lw
    >>> rig = lw.rig(
    ...     masses={"m1": 1.0}, links={"s": "m1 - ground: k*d + c*v"}, known={"s.k": 400.0, "s.c": 0.5}
    ... )
    >>> test = dict(duration=0.4, rate=60.0, noise={"x:m1": 1e-5}, within={"force": 5.0})
    >>> found = lw.best_test(rig, "s.k", unknown=["s"], **test)
    >>> found.plans[0].place, found.plans[0].peak
    ('m1', 5.0)
    """

    kind: str
    place: str
    peak: float
    band: tuple[float, float]
    force: str
    strokes: dict[str, float]
    limit: Limit

    def error_of(self, coefficient: str) -> float:
        """The smallest standard error of a coefficient.

        Parameters
        ----------
        coefficient : str
            Its name.

        Returns
        -------
        float
            In SI units; infinite where it is not determined.
        """
        error = self.limit.coefficient(coefficient).standard_error
        return np.inf if error is None else error

    def command(self, file: str) -> str:
        """The command that simulates the test.

        Parameters
        ----------
        file : str
            The file of the structure.

        Returns
        -------
        str
            The command line.
        """
        record = self.limit.record
        words = ["linkwise", "simulate", file, "--duration", f"{record.duration:g}"]
        words += ["--rate", f"{record.rate:g}", "--force", f"{self.place}={self.force}"]
        return shlex.join([*words, "--sensors", ",".join(self.limit.noise), "-o", "test.csv"])


@dataclass(frozen=True, eq=False, repr=False)
class BestTest(JudgedView):
    """The result of `best_test`: tests in the order of how well they determine a coefficient.

    Attributes
    ----------
    coefficient : str
        Its name.
    plans : tuple of Plan
        The tests, the best first.
    file : str
        The name of the structure's file in the command of each.
    basis : Basis
        The answer that the structure comes from.

    Examples
    --------
    >>> import linkwise as lw
    >>> rig = lw.rig(
    ...     masses={"m1": 1.0}, links={"s": "m1 - ground: k*d + c*v"}, known={"s.k": 400.0, "s.c": 0.5}
    ... )
    >>> test = dict(duration=0.4, rate=60.0, noise={"x:m1": 1e-5}, within={"force": 5.0})
    >>> found = lw.best_test(rig, "s.k", unknown=["s"], **test)
    >>> found.trusted
    True
    """

    coefficient: str
    plans: tuple[Plan, ...]
    file: str = "structure.toml"
    basis: Basis = UNGRADED

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the sensors of the best test determine every unknown."""
        return self.plans[0].limit.verdicts

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            "coefficient", its value and unit, and "tests", the best first; SI units.
        """
        of_best = self.plans[0].limit.coefficient(self.coefficient)
        tests = [
            {
                **{key: getattr(plan, key) for key in ("kind", "place", "peak", "strokes")},
                "band_hz": list(plan.band),
                "sensors": list(plan.limit.noise),
                "standard_error": plan.error_of(self.coefficient),
                "command": plan.command(self.file),
            }
            for plan in self.plans
        ]
        return {
            "method": "limit",
            **self._judgement(),
            "coefficient": self.coefficient,
            "value": of_best.value,
            "unit": of_best.unit,
            "tests": tests,
        }

    def __str__(self) -> str:
        best = self.plans[0]
        of_best = best.limit.coefficient(self.coefficient)
        head = (
            f"{self.coefficient}: {of_best.value:g} ± {best.error_of(self.coefficient):.2g} {of_best.unit} by the best of "
            f"{len(self.plans)} tests, a {best.kind} on {best.place}."
        )
        rows = [("test", "on", "peak, N", "band, Hz", "largest stroke, m", "sensors", "std. error", "")]
        for plan in self.plans[:_ROWS]:
            low, high = plan.band
            stroke = max(plan.strokes.values())
            error = f"{plan.error_of(self.coefficient):.2g}"
            sensors = ", ".join(plan.limit.noise)
            rows.append((
                plan.kind, plan.place, f"{plan.peak:.3g}", f"{low:.3g} to {high:.3g}", f"{stroke:.2g}", sensors, error, ""
            ))  # fmt: skip
        return "\n".join([paragraph(head), "", *align_columns(rows), "", best.command(self.file)])


def best_test(
    structure: Structure,
    coefficient: str,
    *,
    duration: float,
    rate: float,
    noise: Mapping[str, float],
    within: Mapping[str, float],
    unknown: Sequence[str] = (),
    progress: Progress = silent,
) -> BestTest:
    """Choose the hit, sweep or multisine, and the sensors, that determine a coefficient best.

    Tests on every mass, in bands about the lowest modes and over all of them, are compared by `limit` with all sensors, in
    segments of a few periods. The force is the largest that keeps the strokes within their limits, and its half and quarter.
    Of the best tests sensors are left out, one after the other, while the standard error stays within 10 %.

    Parameters
    ----------
    structure : Structure
        The structure with the numbers that are expected, or starts.
    coefficient : str
        An unknown, such as "nes1.beta".
    duration, rate : float
        Length of a test in s and samples per second in Hz.
    noise : mapping of str to float
        The sensors that there are, with the standard deviations of their noise in SI units.
    within : mapping of str to float
        The largest "force" in N, and "stroke" of any link or "stroke:LINK" in m.
    unknown : sequence of str
        What is to be identified, as `limit` takes it.
    progress : Progress
        Called with a `ProgressReport` before each test.

    Returns
    -------
    BestTest
        The tests, the best first.

    Raises
    ------
    IdentificationError
        If no test keeps the limits, or as `limit`.
    SimulationError
        If limits are wrong.

    Examples
    --------
    >>> import linkwise as lw
    >>> plan = dict(duration=0.1, rate=500.0, noise={"x:m1": 1e-5, "x:m2": 1e-5}, within={"force": 5.0})
    >>> found = lw.best_test(lw.bnes_chain(2), "nes1.beta", unknown=["nes"], **plan)
    >>> errors = [test.error_of("nes1.beta") for test in found.plans]
    >>> errors == sorted(errors)
    True
    """
    expect("best_test(structure): structure", structure, Structure)
    _check_limits(within, structure)
    true = structure.with_values({p.name: p.start for p in structure.parameters if p.start is not None})
    frequencies = _frequencies(true, duration, rate)
    segment = float(np.clip(_PERIODS / frequencies[0], SHORTEST, duration))
    forms = list(_tried_forces(frequencies, duration, rate))
    plans: list[Plan] = []

    def bound(place: str, force: Sampled, of: Mapping[str, float]) -> Limit:
        """What a test determines with some of the sensors."""
        test = limit(
            structure, duration=duration, rate=rate, noise=of, unknown=unknown, sensors=tuple(of), segment=segment,
            forces={place: force},
        )  # fmt: skip
        test.coefficient(coefficient)  # is refused if it is none, before all tests are made
        return test

    for number, (place, (kind, band, text)) in enumerate(product(structure.places, forms)):
        progress(ProgressReport(number / (len(forms) * len(structure.places)), f"{kind} on {place}"))
        for peak, strokes in _allowed_sizes(true, place, text, within, (duration, rate)):
            test = bound(place, _sampled(text, peak, duration, rate), noise)
            plans.append(Plan(kind, place, peak, band, f"{peak:.6g}*{text}", strokes, test))
    if not plans:
        raise IdentificationError(
            f"no hit, sweep or multisine of up to {within['force']:g} N keeps the strokes within their limits down to a "
            f"{2**_HALVINGS}th of it: allow a larger stroke, or start from a smaller force",
            arguments=("within",),
        )
    plans.sort(key=lambda plan: plan.error_of(coefficient))
    progress(ProgressReport(0.95, "sensors"))
    for number, plan in enumerate(plans[:_REFINED]):
        force, allowed = _sampled(plan.force, 1.0, duration, rate), _AS_GOOD * plan.error_of(coefficient)
        while len(kept := plan.limit.noise) > 1 and np.isfinite(allowed):
            fewer = [{name: noise[name] for name in kept if name != left_out} for left_out in kept]
            tests = [replace(plan, limit=bound(plan.place, force, some)) for some in fewer]
            plan = min(tests, key=lambda plan: plan.error_of(coefficient))
            if plan.error_of(coefficient) > allowed:
                break
            plans[number] = plan
    plans[:_REFINED] = sorted(plans[:_REFINED], key=lambda plan: plan.error_of(coefficient))
    return BestTest(coefficient, tuple(plans))


def _check_limits(within: Mapping[str, float], structure: Structure) -> None:
    known = ["force", "stroke", *(f"stroke:{link.name}" for link in structure.links)]
    for name, value in within.items():
        if name not in known or not 0.0 < value < np.inf:
            message = f"a limit of a test is a positive number in SI units of {', '.join(known)}, got {name}={value:g}"
            raise SimulationError(message, arguments=("within",))
    if "force" not in within:
        message = "a test needs the largest force that the shaker or hammer exerts: force, in N"
        raise SimulationError(message, arguments=("within",))


def _frequencies(true: Structure, duration: float, rate: float) -> Floats:
    """Natural frequencies in Hz, or some that the test covers where there is no stable rest."""
    try:
        frequencies = natural_frequencies(true)
        frequencies = np.sort(frequencies[frequencies > 0.0])
    except StructureError:
        frequencies = np.array([])
    return frequencies if len(frequencies) else np.geomspace(2.0 / duration, 0.4 * rate, _MODES + 2)[1:-1]


def _tried_forces(
    frequencies: Floats, duration: float, rate: float
) -> Iterator[tuple[str, tuple[float, float], str]]:
    """Kind, band in Hz and expression, of peak 1, of each force that is tried."""
    lowest, highest = 2.0 / duration, 0.4 * rate
    ends = [(frequencies[0] / 2.0, 2.0 * frequencies[-1])]
    ends += [(hz / _BESIDE, hz * _BESIDE) for hz in frequencies[:_MODES]] if len(frequencies) > 1 else []
    for wanted in ends:
        low, high = (float(f"{np.clip(hz, lowest, highest):.4g}") for hz in wanted)
        if not low < high:
            continue
        width = 1.0 / (2.0 * np.pi * high)
        yield "hit", (0.0, high), f"exp(-((t - {4 * width:.5g})/{width:.5g})**2)"
        yield "sweep", (low, high), f"sin(2*pi*({low:g} + {(high - low) / (2.0 * duration):.6g}*t)*t)"
        lines = np.linspace(low, high, _LINES)
        # Schroeder, IEEE Trans. Inf. Theory 16, 1970
        phases = -np.pi * np.arange(_LINES) * (np.arange(_LINES) - 1) / _LINES
        waves = zip(2 * np.pi * lines, phases, strict=True)
        text = " + ".join(f"cos({omega:.6g}*t{phase:+.4g})" for omega, phase in waves)
        peak = np.abs(TimeFunction(text).value(np.arange(0.0, duration, 0.5 / rate))).max()
        yield "multisine", (low, high), f"({text})/{peak:.5g}"


def _sampled(text: str, peak: float, duration: float, rate: float) -> Sampled:
    """An expression by its samples: structures under such forces share one compiled integrator."""
    count = round(duration * rate) + 1
    return Sampled(0.0, rate, peak * TimeFunction(text).value(np.arange(count) / rate))


def _allowed_sizes(
    true: Structure, place: str, text: str, within: Mapping[str, float], sampling: tuple[float, float]
) -> list[tuple[float, dict[str, float]]]:
    """The largest force that keeps the strokes within their limits, and smaller ones, with the strokes by link."""
    sizes: list[tuple[float, dict[str, float]]] = []
    for halving in range(_HALVINGS):
        peak = within["force"] / 2**halving
        forces = {place: _sampled(text, peak, *sampling)}
        try:
            record = simulate(true, duration=sampling[0], rate=sampling[1], forces=forces)
        except SimulationError:  # that diverges, as a softening spring beyond its range
            continue
        assert record.simulated is not None
        d = np.abs(true.elongations(record.simulated.displacement, None)).max(axis=0)
        strokes = {link.name: float(size) for link, size in zip(true.links, d, strict=True)}
        most = within.get("stroke", np.inf)
        if all(size <= within.get(f"stroke:{name}", most) for name, size in strokes.items()):
            sizes.append((peak, strokes))
        if len(sizes) == _SIZES:
            break
    return sizes
