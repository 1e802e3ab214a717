"""Noise that is lowered to the residuals where it was found too large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from duffing_ring import NOISE, SIZE, VALUES, noisy, ring

import linkwise as lw
import linkwise.likelihood.fit as likelihood_fit_module
from linkwise.arrays import Floats
from linkwise.likelihood.noise_level import with_noise_of_residuals
from linkwise.likelihood.shooting.anneal import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

RING = ring(*VALUES.reshape(3, SIZE))


@pytest.mark.parametrize("seed", [1002, 1003, 1005])
def test_noise_that_was_found_is_that_of_the_residuals_where_these_are_less(seed: int) -> None:
    """10 samples a period, of motion with harmonics: 10 to 30 % more noise is found than there is."""
    fit = lw.identify(noisy(seed), RING.unknown("all"))
    scatter = np.sqrt(2.0 / fit.samples)  # of chi-square
    assert fit.trusted
    assert fit.chi_square_per_sample == pytest.approx(1.0, abs=2.0 * scatter)
    sigma = [estimate.sigma for estimate in fit.noise.values()]
    assert np.mean(sigma) == pytest.approx(NOISE, rel=3.0 * scatter / 2.0)


@pytest.mark.parametrize("loose_fails", [False, True])
def test_a_search_beside_the_optimum_that_creeps_starts_again_from_loose_links(
    loose_fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no search converges with less noise, the noise and the fit stay as they were found."""
    searched: list[float] = []

    class Creeping:
        """Searches that do not converge from tight links."""

        def __init__(self, annealer: Annealer) -> None:
            self.annealer, self.loss = annealer, annealer.loss

        def __call__(
            self, segments: Segments, start: Iterate, scales: Scales, schedule: AnnealingSchedule
        ) -> AnnealingFit:
            searched.append(schedule.initial_q)
            annealed = self.annealer(segments, start, scales, schedule)
            fails = schedule.initial_q == schedule.final_q or loose_fails
            return replace(annealed, status=AnnealingStatus.EXHAUSTED) if fails else annealed

    def creeping(segments: Segments, fit: AnnealingFit, annealer: Annealer, lowest: Floats) -> AnnealingFit:
        return with_noise_of_residuals(segments, fit, Creeping(annealer), lowest)  # type: ignore[arg-type]

    monkeypatch.setattr(likelihood_fit_module, "with_noise_of_residuals", creeping)
    fit = lw.identify(noisy(1003), RING.unknown("all"))
    assert searched[:2] == [AnnealingSchedule.final_q, 0.01]
    assert fit.trusted != loose_fails
    scatter = np.sqrt(2.0 / fit.samples)
    assert (fit.chi_square_per_sample == pytest.approx(1.0, abs=2.0 * scatter)) != loose_fails


def test_noise_that_is_stated_stays() -> None:
    record = noisy(1003)
    stated = replace(record, noise=dict.fromkeys(record.channels, 2.0 * NOISE))
    fit = lw.identify(stated, RING.unknown("all"))
    assert fit.chi_square_per_sample == pytest.approx(0.25, abs=3.0 * 0.25 * np.sqrt(2.0 / fit.samples))
    assert fit.verdicts[0] is lw.Verdict.NOISE_MISMATCH


@pytest.mark.parametrize("kind", ["x", "v", "a"])
def test_a_record_without_noise_is_identified(kind: str) -> None:
    """What a simulation gives: its channels count as 160 dB, and no search fits rounding."""
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0, sensors=[kind])
    fit = lw.identify(record, chain.unknown("nes"))
    assert fit.trusted
    truth = np.array([chain.coefficient(parameter.name).value for parameter in fit.parameters])
    assert fit.values == pytest.approx(truth, rel=1e-6)
    assert (np.abs(fit.values - truth) < 4.0 * np.sqrt(fit.covariance.diagonal())).all()


def test_a_record_without_noise_refuses_another_law() -> None:
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
    other = lw.parse_structure(lw.model.format_structure(chain).replace("beta*d**3", "beta*d**2"))
    fit = lw.identify(record, other.unknown("nes"))
    assert not fit.trusted


def test_a_channel_without_noise_does_not_hide_noise_that_is_stated_too_large() -> None:
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
    deviation = 1e-3 * float(np.std(record.channel("x:m1")))
    values = record.values.copy()
    values[:, 0] += deviation * np.random.default_rng(7).standard_normal(len(record))
    noisy_first = replace(record, values=values, simulated=None)
    stated = replace(noisy_first, noise={"x:m1": 10.0 * deviation})
    assert lw.identify(stated, chain.unknown("nes")).verdicts[0] is lw.Verdict.NOISE_MISMATCH
