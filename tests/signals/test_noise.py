"""The white noise of a channel and its bandwidth, told from the record alone, also where motion fills the band."""

import numpy as np
import pytest
from duffing_ring import SIZE, VALUES, ring
from present import present
from problems import chain_record
from scipy.signal import firwin, lfilter

import linkwise as lw
from linkwise.signals.noise import bandwidth, noise_beside_motion, noise_sigma

RATE = 1000.0
TIME = np.arange(6001) / RATE


def _decay() -> np.ndarray:
    """Two decaying channels with bursts of high harmonics at the start, as a sink between wells has them."""
    slow = 5e-3 * np.exp(-0.5 * TIME) * np.sin(2 * np.pi * 27.0 * TIME)
    phase = 2 * np.pi * (22.0 * TIME + 20.0 * (1 - np.exp(-2.0 * TIME)))
    fast = 2e-2 * np.exp(-0.7 * TIME) * np.sin(phase + 2.0 * np.exp(-TIME) * np.sin(3 * phase))
    return np.column_stack([slow, fast + 0.01])


def _noisy(decibel: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    clean = _decay()
    sigma = np.sqrt(np.mean(clean**2, axis=0) * 10 ** (-decibel / 10))
    return clean + np.random.default_rng(seed).normal(size=clean.shape) * sigma, sigma


@pytest.fixture(scope="module", params=[2, 6])
def chain(request: pytest.FixtureRequest) -> lw.Record:
    """The paper's chain: 6 s at 1 kHz, displacements only."""
    return chain_record(request.param)


@pytest.mark.parametrize(("decibel", "limit"), [(10.0, 0.05), (20.0, 0.05), (40.0, 0.05), (60.0, 0.1)])
def test_the_noise_of_the_paper_s_chains_is_found(chain: lw.Record, decibel: float, limit: float) -> None:
    # 5 % are four standard deviations of the estimate; at 60 dB the sinks' jumps fill a third of the cells and add to it.
    noisy = chain.with_noise(decibel, seed=1)
    sigma = np.array([present(noisy.simulated).noise[name] for name in noisy.channels])
    np.testing.assert_allclose(noise_sigma(noisy.values), sigma, rtol=limit)


def test_motion_alone_is_not_taken_for_noise_nor_between_gaps_and_units_scale_it() -> None:
    clean = _decay()
    # 0.1 % of the motion, that is 60 dB: measured 3e-11
    limit = 1e-3 * np.sqrt(np.mean(clean**2, axis=0))
    assert np.all(noise_sigma(clean) < limit)
    holed = np.where(np.random.default_rng(6).random(clean.shape) < 0.2, np.nan, clean)
    assert np.all(noise_sigma(holed) < limit)
    noisy, _ = _noisy(20.0, 3)
    np.testing.assert_allclose(noise_sigma(1e3 * noisy), 1e3 * noise_sigma(noisy), rtol=1e-12)


@pytest.mark.parametrize("missing", [0.1, 0.2, 0.3])
def test_noise_is_found_where_no_block_is_complete(missing: float) -> None:
    """Differences of order 8 in N = 6001 samples have a standard error of 2 %, larger where gaps stretch them: four of 3 %."""
    ratios = []
    for seed in range(4):
        noisy, sigma = _noisy(20.0, seed)
        holed = np.where(np.random.default_rng(seed + 10).random(noisy.shape) < missing, np.nan, noisy)
        ratios.append(noise_sigma(holed) / sigma)
    assert np.max(np.abs(np.array(ratios) - 1.0)) < 0.12


@pytest.mark.parametrize("still", [0.2, 0.4, 0.8])
def test_an_encoder_that_rests_has_the_noise_of_its_steps(still: float) -> None:
    """Rounding to a step is noise of variance step^2 / 12 while the encoder moves; at rest it shows none."""
    time, step = np.arange(8000) / 200.0, 1e-4
    moving = np.maximum(time - still * time[-1], 0.0)
    shown = step * np.round((np.minimum(moving, 1.0) * 0.03 * np.sin(9.0 * time) + 0.0123) / step)
    assert noise_sigma(shown)[0] == pytest.approx(step / np.sqrt(12.0), rel=0.1)


def test_the_bandwidth_is_where_the_motion_sinks_into_the_noise_or_where_that_is_known() -> None:
    random = np.random.default_rng(1)
    tones = sum(np.sin(2 * np.pi * f * TIME + f) for f in (20.0, 75.0, 140.0))
    width = bandwidth(tones + 0.05 * random.normal(size=TIME.size), RATE)
    # Bins are rate / 256 = 3.9 Hz wide and the Hann window is two bins wide to each side.
    assert 140.0 - 4.0 < width[0] < 140.0 + 3 * 4.0
    noisy, sigma = _noisy(20.0, 4)
    np.testing.assert_array_equal(bandwidth(noisy, RATE, noise_sigma(noisy)), bandwidth(noisy, RATE))
    assert np.all(bandwidth(noisy, RATE, 100 * sigma) < bandwidth(noisy, RATE))


def test_the_bandwidth_of_noise_is_one_bin_and_of_a_full_band_half_the_rate() -> None:
    random = np.random.default_rng(2)
    impulses = np.zeros(TIME.size)
    impulses[::512] = 1.0
    both = np.column_stack([random.normal(size=TIME.size), impulses + 1e-6 * random.normal(size=TIME.size)])
    width = bandwidth(both, RATE)
    assert width[0] == pytest.approx(RATE / 256)
    # half the rate to within five bins, the width of the Hann window
    assert width[1] > 0.48 * RATE


def test_a_record_full_of_holes_has_no_bandwidth() -> None:
    values = np.random.default_rng(3).normal(size=1000)
    values[::20] = np.nan
    with pytest.raises(lw.RecordError, match=r"bandwidth of x:m1 .* no 256 consecutive .*record\.between"):
        bandwidth(values, RATE, names=["x:m1"])


def test_motion_up_to_half_the_sampling_rate_is_not_taken_for_noise() -> None:
    """The ring at 2 Hz, of which 30 dB below the motion is above the band: noise was found 7 to 13 times too large."""
    release = {f"x:m{k + 1}": 1.0 for k in range(SIZE)}
    clean = lw.simulate(ring(*VALUES.reshape(3, SIZE)), release=release, duration=59.8, rate=2.0)
    true = np.sqrt(np.mean(clean.values**2, axis=0)) * 10.0 ** (-24.0 / 20.0)
    rng = np.random.default_rng(5_003_700)
    noisy = (clean.values + true * rng.normal(size=clean.values.shape) for _ in range(20))
    ratios = np.array([noise_sigma(values) / true for values in noisy])
    assert 1.0 < np.median(ratios) < 4.0  # no lower, since a misfit of laws would be found
    assert ratios.min() > 0.8


def test_white_noise_stays_what_it_is_and_behind_an_anti_aliasing_filter_mostly_does() -> None:
    """It falls at the end of the band alone, which chance makes look like motion in one of ten short records."""
    samples = np.random.default_rng(5_003_701).normal(size=(500, 120))
    levels = np.array([noise_beside_motion(each, 1.0) for each in samples])
    assert np.mean(levels < 1.0) <= 0.005
    white = np.random.default_rng(5_003_702).normal(size=(500, 300))
    filtered = lfilter(firwin(61, 0.8), 1.0, white)[:, 60:]
    levels = np.array([noise_beside_motion(each, 1.0) for each in filtered])
    assert np.mean(levels < 1.0) <= 0.06
