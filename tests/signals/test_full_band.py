"""The noise of channels whose motion fills the band up to half the sampling rate."""

import numpy as np
from duffing_ring import SIZE, VALUES, ring
from scipy.signal import firwin, lfilter

import linkwise as lw
from linkwise.signals.noise import noise_beside_motion, noise_sigma


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
