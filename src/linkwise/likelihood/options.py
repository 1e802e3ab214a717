"""Options of a maximum-likelihood fit, and how users type those that `identify` and `discover` share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.random_forces import RandomForce
from linkwise.likelihood.shooting.anneal import AnnealingSchedule
from linkwise.likelihood.shooting.loss import Gaussian, Loss
from linkwise.progress import Progress, silent

CALIBRATION = {"typed": "CHANNEL=PERCENT%", "unit": "%", "example": "x:m1=1%"}
ADMIT = {"typed": "gain,offset,delay"}
AMBIENT = {"typed": "MASS[=DENSITY]", "unit": "N/sqrt(Hz)", "example": "m1=0.5"}
INPUT_NOISE = {"typed": "CHANNEL[=SIGMA]", "unit": "channel", "example": "force:m1=0.5"}


@dataclass(frozen=True)
class LikelihoodOptions:
    """Options of `likelihood_fit`.

    Parameters
    ----------
    offsets, gains : sequence of str, optional
        Channels with an unknown constant error or factor; of factors also those of applied forces.
    calibration : mapping of str to float, optional
        Relative standard deviations to which gains are known beforehand, by channel; ``"common"`` is a factor of all.
    delays : sequence of str, optional
        Channels with an unknown delay, of 1.5 samples at most; of applied forces, too.
    offset_deviations, delay_deviations : mapping of str to float, optional
        Standard deviations to which offsets and delays are known beforehand, in SI units by channel.
    shifts : mapping of str to float, optional
        Parts in s of delays that have been taken out of the records.
    drifts : mapping of str to float or None, optional
        Channels with an unknown slow drift, and the lengths of its pieces in s.
    hums : mapping of str to sequence of float, optional
        Frequencies in Hz of hums of unknown amplitude and phase, by channel.
    random : sequence of RandomForce, optional
        Random forces on masses.
    loss : Loss, optional
        Loss of a residual.
    model_error : bool, optional
        Relax the flow by the most likely model error where the residuals are not noise.
    coloured_noise : bool, optional
        With `model_error`, allow for autoregressive noise of sensors where the residuals are that.
    progress : Progress, optional
        Called at every step.
    nodes : array of shape (2n + S, K), optional
        States of another fit to the same records to start from; estimated from the channels by default.
    ceiling : float, optional
        Cost per sample above which the laws are wrong and the continuity is not tightened further.
    steps : int, optional
        Largest number of steps.
    tightest : float, optional
        Relaxation at which the search ends; that of exact laws by default.
    """

    offsets: Sequence[str] = ()
    gains: Sequence[str] = ()
    calibration: Mapping[str, float] = field(default_factory=dict)
    delays: Sequence[str] = ()
    offset_deviations: Mapping[str, float] = field(default_factory=dict)
    delay_deviations: Mapping[str, float] = field(default_factory=dict)
    shifts: Mapping[str, float] = field(default_factory=dict)
    drifts: Mapping[str, float | None] = field(default_factory=dict)
    hums: Mapping[str, Sequence[float]] = field(default_factory=dict)
    random: Sequence[RandomForce] = ()
    loss: Loss = field(default_factory=Gaussian)
    model_error: bool = True
    coloured_noise: bool = True
    progress: Progress = field(default=silent, repr=False)
    nodes: Floats | None = None
    relaxation: float | None = None
    ceiling: float = np.inf
    steps: int = AnnealingSchedule.max_steps
    tightest: float = AnnealingSchedule.final_q

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled, with the fit that it belongs to: all but the progress, which is for this process only."""
        return {**vars(self), "progress": silent}
