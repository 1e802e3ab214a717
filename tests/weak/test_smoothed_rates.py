"""What the smoothing of rates does to coefficients is in their intervals; laws that are smooth by the rate keep theirs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.weak import estimate as weak_estimate


def forced(law: str, size: float) -> tuple[lw.Structure, lw.Record]:
    true = oscillator(f"k*d + c*v + F*{law}", k=1000.0, c=1.0, F=size)
    drive = {"m1": "5*sin(25*t)"}
    return true, lw.simulate(true, release={"v:m1": 1.0}, forces=drive, duration=6.0, rate=1000.0)


def errors_of_the_spring(law: str, snr_db: float) -> Iterator[float]:
    """In standard errors, of those of eight records that are trusted."""
    true, record = forced(law, 0.5)
    for seed in range(8):
        fit = lw.identify(record.with_noise(snr_db, seed=seed), true.unknown("all"), method="weak")
        if fit.trusted:
            yield abs(float(fit.values[0] - 1000.0)) / float(np.sqrt(fit.covariance[0, 0]))


@pytest.mark.parametrize(
    ("law", "snr_db"), [("sign(v)", 40.0), ("tanh(v/0.02)", 40.0), ("tanh(v/0.02)", 60.0)]
)
def test_intervals_include_what_smoothing_does_to_friction(law: str, snr_db: float) -> None:
    """Six of eight records at least are trusted, none 4.5 standard errors off."""
    found = list(errors_of_the_spring(law, snr_db))
    assert len(found) >= 6
    assert max(found) < 4.5


def test_without_them_friction_that_jumps_misleads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weak_estimate, "with_smoothing", lambda *arguments: arguments[-1])
    assert max(errors_of_the_spring("sign(v)", 40.0)) > 4.5


def test_intervals_of_smooth_damping_are_hardly_wider(monkeypatch: pytest.MonkeyPatch) -> None:
    """The change of values by more smoothing is a part of a standard error, and adds to it by squares."""
    true, record = forced("v*abs(v)", 2.0)
    noisy, asked = record.with_noise(40.0, seed=0), true.unknown("all")
    wide = np.sqrt(lw.identify(noisy, asked, method="weak").covariance.diagonal())
    monkeypatch.setattr(weak_estimate, "with_smoothing", lambda *arguments: arguments[-1])
    plain = np.sqrt(lw.identify(noisy, asked, method="weak").covariance.diagonal())
    assert np.all(wide >= plain)
    assert np.max(wide / plain) < 1.5
