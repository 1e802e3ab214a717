"""The printed answer, word for word: one that can be trusted and one that cannot."""

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.display import format_error, format_value
from linkwise.estimates.causes import NoiseEstimate
from linkwise.estimates.link_estimate import LinkMotion

GOOD = """\
bistable chain of 2 masses: weak, converged, can be trusted
The laws explain the record to within its noise. (12002 samples, chi-square 1.003, 0.012 s)

  noise   deviation  signal/noise
  x:m1   0.000115 m  20.0 dB
  x:m2          0 m  no noise

masses
        value  std. error       95 % interval  unit
  m2  0.01002     0.00031  0.00941 to 0.01063  kg

nes1 (m2 - m1): alpha*d + beta*d**3 + c*v
                   value  std. error           95 % interval  unit
  alpha           -99.56        0.44       -100.43 to -98.69  N/m
  beta            998197        2000       994228 to 1002166  N/m^3
  c              0.01971     0.00090      0.01795 to 0.02148  N s/m
  well 1       -0.009987              -0.010035 to -0.009939  m
  well 2        0.009987                0.009939 to 0.010035  m
  barrier       0.002482                0.002438 to 0.002527  J
  frequency 1     22.547                    22.448 to 22.645  Hz
  frequency 2     22.547                    22.448 to 22.645  Hz
  range: d -0.03054 to 0.02969 m, v -5.6 to 5.6 m/s"""

BAD = """\
bistable chain of 2 masses: weak, chi-square off, NOT to be trusted
The laws explain the record to within 3.1 % of its forces, which is 4.53 times what noise would
leave. No interval is given. (12002 samples, chi-square 20.530, 0.012 s)

  noise   deviation  signal/noise
  x:m1   0.000115 m  20.0 dB
  x:m2          0 m  no noise

masses
         value  std. error  95 % interval  unit
  m2  0.010021        none                 kg

nes1 (m2 - m1): alpha*d + beta*d**3 + c*v
                     value  std. error  95 % interval  unit
  alpha            -99.557        none                 N/m
  beta              998197        none                 N/m^3
  c               0.019714        none                 N s/m
  well 1       -0.00998683                             m
  well 2        0.00998683                             m
  barrier       0.00248237                             J
  frequency 1      22.5466                             Hz
  frequency 2      22.5466                             Hz
  range: d -0.03054 to 0.02969 m, v -5.6 to 5.6 m/s

! 12 samples are missing; equations that need them are left out. A sentence that is too long for one
  line is broken."""


def answer() -> lw.Estimate:
    """An answer with figures that nothing computed."""
    unknown = lw.bnes_chain(2).unknown("nes", "mass:m2")
    values = {"nes1.alpha": -99.557, "nes1.beta": 998197.3, "nes1.c": 0.019714, "m2.mass": 0.010021}
    errors = {"nes1.alpha": 0.4434, "nes1.beta": 2025.0, "nes1.c": 9.02e-4, "m2.mass": 3.1e-4}
    steps = np.linspace(-1.0, 1.0, 5)[:, None]
    return lw.Estimate(
        method="weak",
        fit_verdicts=(lw.Verdict.CONVERGED,),
        message="The laws explain the record to within its noise.",
        seconds=0.0123,
        given_structure=unknown,
        parameters=unknown.parameters,
        values=np.array([values[parameter.name] for parameter in unknown.parameters]),
        covariance=np.diag([errors[parameter.name] ** 2 for parameter in unknown.parameters]),
        free=np.ones(len(values), dtype=bool),
        noise={"x:m1": NoiseEstimate(1.1512e-4, "m", 20.02), "x:m2": NoiseEstimate(0.0, "m", np.inf)},
        chi_square_per_sample=1.0031,
        samples=12002,
        compute_motion=lambda: LinkMotion(
            structure=unknown.with_values(values),
            time=np.arange(5) / 1000.0,
            d=steps * [0.005, 0.03],
            v=steps * [0.9, 5.6],
            d_range=np.array([[-0.00563, 0.00567], [-0.03054, 0.02969]]),
            compute_residual=lambda: None,
        ),
        record=chain_record(2).with_noise(20.0, seed=1),
    )


def test_an_answer_that_can_be_trusted_and_one_that_cannot() -> None:
    assert str(answer()) == GOOD
    refused = replace(
        answer(),
        fit_verdicts=(lw.Verdict.NOISE_MISMATCH,),
        message="The laws explain the record to within 3.1 % of its forces, which is 4.53 times what noise would leave.",
        chi_square_per_sample=20.53,
        remarks=(
            "12 samples are missing; equations that need them are left out. A sentence that is too long for one line is "
            "broken.",
        ),
    )
    assert str(refused) == BAD


@pytest.mark.slow
def test_long_chains_are_cut() -> None:
    """Of 28 channels and 14 sinks twelve are shown, and the table says so."""
    chain = lw.bnes_chain(28)
    record = chain_record(28, duration=0.2).with_noise(40.0, seed=1)
    printed = str(lw.identify(record, chain.unknown("nes"), method="weak"))
    assert "... and 16 more channels" in printed
    assert "... and 2 more links; the result folder lists all of them" in printed
    assert "nes12 (" in printed and "nes13 (" not in printed


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (3.14159265, None, "3.14159"),
        (3.14159265, 0.02, "3.142"),
        (-99.557, 0.4434, "-99.56"),
        (998197.3, 2025.0, "998197"),
        (3.7397e11, 2.2e9, "3.740e+11"),
        (4.1e-9, 3e-11, "4.100e-09"),
        (0.0, 0.02, "0.000"),
        (float("nan"), 1.0, "nan"),
        (2.0, 0.0, "2"),
    ],
)
def test_numbers_end_with_their_error(value: float, error: float | None, text: str) -> None:
    assert format_value(value, error) == text


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (0.4434, "0.44"),
        (2025.0, "2000"),
        (9.02e-4, "0.00090"),
        (3.5e-6, "3.5e-06"),
        (2.2e9, "2.2e+09"),
        (14.2, "14"),
    ],
)
def test_errors_have_two_digits(error: float, text: str) -> None:
    assert format_error(error) == text
