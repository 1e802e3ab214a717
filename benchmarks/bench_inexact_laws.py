"""Laws that are a little wrong: coverage of what the other coefficients are in the long run, and structures from wrong offers.

LINKWISE_SEEDS says how many records of each kind (default 100 for coverage, 50 structures), LINKWISE_FIRST_SEED the first of
those of coverage.
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
import scipy

import linkwise as lw

SEEDS = int(os.environ.get("LINKWISE_SEEDS", "100"))
FIRST_SEED = int(os.environ.get("LINKWISE_FIRST_SEED", "7000"))  # of no test, and never tuned on
STRUCTURES = int(os.environ.get("LINKWISE_SEEDS", "50"))
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
RATE, SNR = 200.0, 40.0
LAW = "k*d + c*v + k3*d**3"
VALUES = {"k": 987.0, "c": 6.0, "k3": 4e5}
MISSING = {  # a term, and its size for 1 N root mean square on these motions
    "quintic": ("d**5", 6.4e7),
    "gap": ("(max(d - 0.02, 0) + min(d + 0.02, 0))", 1100.0),
    "stribeck": ("exp(-(v/0.1)**2)*tanh(v/0.01)", 3.3),
    "place": ("sin(d/0.01)*tanh(v/0.02)", 1.5),
}
HYSTERESIS = "hysteresis"
ONLY_NOISE = "The laws explain the record to within its noise."
FORCE = 11.0  # N root mean square of the link
SHARES = (0.001, 0.01, 0.05)
DURATIONS = (10.0, 30.0, 60.0)  # s
LONG = 1800.0  # s of a record as good as endless: its own errors are 18 % of those of 60 s, which adds 1.7 % to them
ENDLESS_SEED = 6999
COVERED = (0.90, 0.98)  # what 95 % intervals are to cover
BEYOND = 5.0  # stated errors: no trusted coefficient is to be farther off
WIDENED = 0.15
"""Of exact records: one in 22 for a power, in 80 for each of two other usual terms of a link, in 40 for an input, in 50 for
blocks and scores together."""


def random_force(
    rng: np.random.Generator, duration: float, rate: float, band: tuple[float, float]
) -> np.ndarray:
    """Normal, of 1 N root mean square, flat from the lower to the upper frequency in Hz."""
    samples = round(duration * rate) + 1
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    inside = (frequency > band[0]) & (frequency < band[1])
    spectrum = (rng.normal(size=len(inside)) + 1j * rng.normal(size=len(inside))) * inside
    force = np.fft.irfft(spectrum, samples)
    return np.asarray(force / force.std())


def chain(law: str, masses: int = 1, **values: float) -> lw.Structure:
    """Masses of 1 kg, the first on the ground, each on the one before it by the same law."""
    names = [f"m{k + 1}" for k in range(masses)]
    coefficients = {name: lw.Coefficient.number(value) for name, value in values.items()}
    links = tuple(
        lw.Link(f"spring {end}", (end, before), lw.Law.parse(law), coefficients)
        for end, before in zip(names, ["ground", *names], strict=False)
    )
    return lw.Structure("chain", tuple(lw.Mass(name, lw.Coefficient.number(1.0)) for name in names), links)


def with_missing(kind: str, share: float) -> lw.Structure:
    """The oscillator with a `share` of its force from the missing term, or from hysteresis as Bouc and Wen describe it."""
    if kind != HYSTERESIS:
        term, size = MISSING[kind]
        return chain(f"{LAW} + q*{term}", **VALUES, q=share * FORCE * size)
    plain = chain(LAW, **VALUES)
    loop = {"k": 0.0, "c": 0.0, "F": 1.2 * share * FORCE, "x0": 0.003, "s": 0.5}
    numbers = {name: lw.Coefficient.number(value) for name, value in loop.items()}
    joint = lw.model.named_law("bouc-wen").link("joint", ("m1", "ground"), numbers)
    return replace(plain, links=(*plain.links, joint))


def record_of(truth: lw.Structure, duration: float, seed: int) -> lw.Record:
    """The structure under a random force of 6 N on its last mass, flat from 1 to 12 Hz."""
    last = truth.masses[-1].name
    force = lw.model.Sampled(
        0.0, RATE, 6.0 * random_force(np.random.default_rng(seed), duration, RATE, (1.0, 12.0))
    )
    return lw.simulate(truth, forces={last: force}, duration=duration, rate=RATE).with_noise(SNR, seed=seed)


@dataclass(frozen=True, eq=False)
class Coverage:
    """What `identify` answers to records of one kind.

    `z` (trusted, p) are deviations of coefficients from the values of the endless record in stated errors, `z_true` those from
    the true values, which a wrong law has not, and `plain` says how many records are told to leave no more than noise.
    """

    names: list[str]
    verdicts: Counter[str]
    z: np.ndarray
    z_true: np.ndarray
    plain: int

    @property
    def short(self) -> bool:
        """Whether too few 95 % intervals cover the values of the endless record, or one is too far from them."""
        return bool(
            len(self.z) and (np.mean(self.z < 1.96, axis=0).min() < COVERED[0] or self.z.max() > BEYOND)
        )

    def __str__(self) -> str:
        told = ", ".join(f"{name.lower().replace('_', ' ')} {count}" for name, count in self.verdicts.items())
        if not len(self.z):
            return f"trusted 0; {told}"
        parts = [
            f"{name} {_in_percent(z)}, true {_in_percent(z_true)}"
            for name, z, z_true in zip(self.names, self.z.T, self.z_true.T, strict=True)
        ]
        return f"trusted {len(self.z)}, no more than noise {self.plain}; {'; '.join(parts)}; {told}"


def _in_percent(z: np.ndarray) -> str:
    return f"{100.0 * np.mean(z < 1.96):.0f} ({z.max():.1f})"


def coverage(truth: lw.Structure, plain: lw.Structure, endless: np.ndarray, duration: float) -> Coverage:
    """Of records of a `truth`, identified by the laws of the structure `plain`, against values of an `endless` record."""
    structure = plain.unknown("all")
    true = np.array([VALUES[parameter.name.rpartition(".")[2]] for parameter in structure.parameters])
    fits = [
        lw.identify(record_of(truth, duration, seed), structure)
        for seed in range(FIRST_SEED, FIRST_SEED + SEEDS)
    ]
    trusted = [fit for fit in fits if fit.grade is not lw.Grade.REFUSED]
    errors = np.array([np.sqrt(np.asarray(fit.covariance).diagonal()) for fit in trusted])
    errors = errors.reshape(-1, len(true))
    values = np.array([fit.values for fit in trusted]).reshape(errors.shape)
    return Coverage(
        names=[parameter.name.rpartition(".")[2] for parameter in structure.parameters],
        verdicts=Counter(fit.verdicts[0].name for fit in fits),
        z=np.abs(values - endless) / errors,
        z_true=np.abs(values - true) / errors,
        plain=sum(fit.message == ONLY_NOISE for fit in fits),
    )


@pytest.mark.parametrize("kind", [*sorted(MISSING), HYSTERESIS])
def test_coverage_under_a_wrong_law(kind: str) -> None:
    """How often 95 % intervals cover the values of an endless record, and the true ones, which a wrong law has not.

    Of each coefficient in %, with the worst deviation in stated errors. Where the missing term is named, intervals hold what
    it would make of the coefficients, so that they cover the values of the endless record more often.
    """
    plain, short = chain(LAW, **VALUES), []
    print()
    for share in SHARES:
        truth = with_missing(kind, share)
        endless = lw.identify(record_of(truth, LONG, ENDLESS_SEED), plain.unknown("all")).values
        for duration in DURATIONS:
            covers = coverage(truth, plain, endless, duration)
            print(f"{kind} {100.0 * share:g} %, {duration:g} s: {covers}", flush=True)
            if covers.short:
                short.append(f"{100.0 * share:g} % at {duration:g} s")
    print(
        f"{kind}, fewer than {100.0 * COVERED[0]:g} % or beyond {BEYOND:g} errors: {', '.join(short) or 'none'}"
    )


@pytest.mark.parametrize("masses", [1, 2])
def test_coverage_under_exact_laws(masses: int) -> None:
    """The same where nothing is missing: intervals are no wider than noise makes them."""
    truth = chain(LAW, masses, **VALUES)
    true = np.tile(list(VALUES.values()), masses)
    print()
    for duration in DURATIONS:
        covers = coverage(truth, truth, true, duration)
        print(f"exact, {masses} masses, {duration:g} s: {covers}", flush=True)
        assert COVERED[0] <= np.mean(covers.z < 1.96) <= COVERED[1]
        assert np.max(covers.z) < BEYOND
        assert covers.plain >= (1.0 - WIDENED) * SEEDS


def wrong_offer(seed: int) -> tuple[lw.Structure, lw.Record]:
    """A random tree of 2 to 4 masses, each link with 1 to 3 % of its force in a term that no candidate has."""
    rng = np.random.default_rng(seed)
    count, rate, duration = int(rng.integers(2, 5)), 400.0, 20.0
    masses = tuple(
        lw.Mass(f"m{k + 1}", lw.Coefficient.number(float(rng.uniform(0.5, 2.0)))) for k in range(count)
    )
    ends = [(f"m{k + 1}", "ground" if k == 0 else f"m{int(rng.integers(0, k)) + 1}") for k in range(count)]
    terms = rng.choice(["d**5", "v*d**2", "sign(d)*d**2", "v*abs(v)"], count).tolist()
    k = rng.uniform(500.0, 3000.0, count)
    c, k3 = rng.uniform(0.5, 3.0, count), rng.uniform(0.0, 440.0, count) * k
    shares = rng.uniform(0.01, 0.03, count)
    forces = {
        mass.name: lw.model.Sampled(
            0.0, rate, 8.0 * random_force(rng, duration, rate, (1.0, 20.0)), band_limited=True
        )
        for mass in masses
    }

    def structure(sizes: np.ndarray) -> lw.Structure:
        links = []
        for number, between in enumerate(ends):
            law = lw.Law.parse(f"k*d + c*v + k3*d**3 + q*{terms[number]}")
            values = {"k": k[number], "c": c[number], "k3": k3[number], "q": sizes[number]}
            coefficients = {name: lw.Coefficient.number(float(value)) for name, value in values.items()}
            links.append(lw.Link("-".join(between), between, law, coefficients))
        return lw.Structure("tree", masses, tuple(links))

    without = structure(np.zeros(count))
    record = lw.simulate(without, forces=forces, duration=duration, rate=rate)
    sizes = np.zeros(count)
    for number, link in enumerate(without.links):
        x = [record.channel(f"x:{end}") if end != "ground" else np.zeros(len(record)) for end in ends[number]]
        d = x[0] - x[1]
        v = np.gradient(d, 1.0 / rate)
        unit = lw.Law.parse(terms[number]).force(d, v, {})
        sizes[number] = shares[number] * link.law.force(d, v, link.values).std() / np.std(unit)
    truth = structure(sizes)
    clean = lw.simulate(truth, forces=forces, duration=duration, rate=rate)
    return truth, clean.with_noise(30.0, seed=seed)


def test_structures_from_wrong_offers() -> None:
    exact, trusted, false_certain, wrong_trusted, seconds = 0, 0, 0, 0, []
    print()
    for seed in range(STRUCTURES):
        truth, record = wrong_offer(seed)
        links = {frozenset(link.between) for link in truth.links}
        started = perf_counter()
        discovery = lw.discover(record, {mass.name: mass.mass.value or 0.0 for mass in truth.masses})
        seconds.append(perf_counter() - started)
        right = {frozenset(link.between) for link in discovery.structure.links} == links
        exact, trusted = exact + right, trusted + discovery.trusted
        wrong_trusted += discovery.trusted and not right
        false_certain += sum(
            term.kept and term.certain and frozenset(term.between) not in links for term in discovery.terms
        )
        if not (right and discovery.trusted):
            graph = "right" if right else "WRONG"
            print(f"  seed {seed}: graph {graph}, {discovery.estimate.message[:150]}", flush=True)
    print(
        f"wrong offers, {STRUCTURES} structures: graph exact {exact}, trusted {trusted}, wrong and trusted {wrong_trusted}, "
        f"false links told as certain {false_certain}; median {np.median(seconds):.1f} s"
    )
    assert exact >= 0.9 * STRUCTURES
    assert wrong_trusted == 0
    assert false_certain == 0


def test_servo_axis() -> None:
    """EMPS; scatter of pieces over stated error is asked to be 1.5 at most, and no spring is certain."""
    if not (DATA / "emps.mat").exists():
        pytest.skip("no emps.mat beside the checkout")
    data = scipy.io.loadmat(DATA / "emps.mat")
    force = data["vir"].ravel() * float(data["gtau"].item())
    record = lw.Record.from_arrays(data["t"].ravel(), {"x:m1": data["qm"].ravel(), "force:m1": force})
    law = lw.Law.parse("fv*v + fc*sign(v) + off")
    unknown = {name: lw.Coefficient.unknown() for name in law.coefficients}
    link = lw.Link("friction", ("m1", "ground"), law, unknown)
    axis = lw.Structure("axis", (lw.Mass("m1", lw.Coefficient.unknown()),), (link,))
    length = len(record) // 5
    whole = lw.identify(record, axis)
    pieces = [lw.identify(record[k * length : (k + 1) * length], axis) for k in range(5)]
    scatter = np.std([piece.values for piece in pieces], axis=0, ddof=1)
    stated = np.sqrt(np.mean([piece.covariance.diagonal() for piece in pieces], axis=0))
    print("\nEMPS, five pieces, scatter over stated error:", np.round(scatter / stated, 2))
    assert np.all(scatter < 1.5 * stated)
    assert np.all(scatter < 1.5 * np.sqrt(5.0) * np.sqrt(whole.covariance.diagonal()))
    started = perf_counter()
    terms = "1, d, d**2, d**3, v, v*abs(v), sign(v), stribeck(0.01)"
    discovery = lw.discover(record, {"m1": "unknown"}, terms=terms)
    print(f"EMPS, discover: {perf_counter() - started:.0f} s\n{discovery}")
    assert discovery.estimate.coefficient("m1.mass").value == pytest.approx(95.109, rel=0.01)  # published
    assert {"1", "v", "sign(v)"} <= {term.term for term in discovery.terms if term.kept}
    assert not [term for term in discovery.terms if term.kept and term.certain and term.term.startswith("d")]


def test_silverbox() -> None:
    """Twelve terms, mass unknown, on the first four fifths; free run over the last."""
    if not (DATA / "silverbox_multisine.csv").exists():
        pytest.skip("no silverbox_multisine.csv beside the checkout")
    record = lw.read_record(DATA / "silverbox_multisine.csv")
    seen = 4 * len(record) // 5
    terms = "1, d, d**2, d**3, d**4, d**5, v, v*abs(v), v*d, v*d**2, sign(v), v**3"
    started = perf_counter()
    discovery = lw.discover(record[:seen], {"m1": "unknown"}, terms=terms)
    seconds = perf_counter() - started
    rmse = lw.analysis.free_run(discovery.structure, record[seen:], settling=50).rmse["x:m1"]
    print(f"\nSilverbox, discover: {seconds:.0f} s, free run {1e3 * rmse:.3f} mV\n{discovery}")
    assert rmse < 3.1e-4
    assert discovery.grade is not lw.Grade.REFUSED and len(discovery.estimate.parameters) <= 10
