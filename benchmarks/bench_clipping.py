"""Every channel clipped at 80 % of its peak: errors of the coefficients where clipped samples are taken as bounds.

The paper's chain of two masses at 20 and 40 dB, 20 seeds each.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw

PEAK = 0.8
FIRST, SEEDS = 4000, 20  # seeds of no test
MOST = 1.5  # times the errors of the whole record


@pytest.mark.parametrize("snr_db", [20.0, 40.0])
def test_errors_beside_those_of_the_whole_record(snr_db: float) -> None:
    chain = lw.bnes_chain(2)
    clean = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0)
    asked = chain.unknown("all")
    true = np.array([chain.coefficient(p.name).value for p in asked.parameters], dtype=float)
    errors: dict[str, list[np.ndarray]] = {"whole": [], "marked": []}
    widths: dict[str, list[np.ndarray]] = {"whole": [], "marked": []}
    trusted = 0
    for seed in range(FIRST, FIRST + SEEDS):
        whole = clean.with_noise(snr_db, seed=seed)
        peak = PEAK * np.max(np.abs(whole.values), axis=0)
        overloaded = replace(whole, values=np.clip(whole.values, -peak, peak), simulated=None)
        trusted += lw.identify(overloaded, asked).trusted
        for name, record in (("whole", whole), ("marked", lw.inspection.mark_missing(overloaded))):
            fit = lw.identify(record, asked)
            assert fit.trusted
            errors[name].append(fit.values - true)
            widths[name].append(np.sqrt(fit.covariance.diagonal()))
    rms = {name: np.sqrt(np.mean(np.square(each), axis=0)) for name, each in errors.items()}
    width = {name: np.median(each, axis=0) for name, each in widths.items()}
    print(f"\n{SEEDS} records at {snr_db:g} dB, clipped at {PEAK:.0%}: {trusted} trusted as they are")
    for number, parameter in enumerate(asked.parameters):
        print(
            f"  {parameter.name:12} errors {rms['marked'][number] / rms['whole'][number]:.2f}, standard errors "
            f"{width['marked'][number] / width['whole'][number]:.2f} of those of the whole record"
        )
    assert (rms["marked"] < MOST * rms["whole"]).all()
    assert (width["marked"] < MOST * width["whole"]).all()
