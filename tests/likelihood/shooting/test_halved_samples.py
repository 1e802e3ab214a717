"""Every second sample: sums over smooth columns are those over all samples, and what is not smooth keeps them all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import rubbing_trio, truth

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.shooting.halved_samples import halved
from linkwise.likelihood.shooting.loss import Gaussian, Student
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segmentation import cut_segments
from linkwise.likelihood.shooting.segments import A, Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import System

COUNTS = (21, 20)  # segments of two records, whose last one is not full


@pytest.fixture(scope="module")
def problem() -> tuple[Segments, Misfit]:
    """Two records of displacements and velocities with an odd number of samples, and residuals of noise."""
    three = rubbing_trio()
    unknown = three.unknown("all")
    records = [
        lw.simulate(
            three, times=np.arange(6 * count - 3) / 1000.0, sensors=("x", "v"), release={"v:m1": 1.0},
            forces={"m2": "5*sin(400*t)"}, base="0.001*sin(300*t)",
        ).with_noise(30.0, seed=count)
        for count in COUNTS
    ]  # fmt: skip
    noise = [np.full(len(records[0].responses), level) for level in (1.0, 2.0)]
    system = System.of(unknown)
    segments = cut_segments(records, unknown, system, samples=6, refine=1, relative_noise=noise)
    point = Iterate(np.zeros((system.dimension, segments.count)), truth(three, unknown), np.zeros(0))
    misfit = evaluate(segments, point, scales_of(segments), Gaussian())
    residuals = np.random.default_rng(5).normal(size=misfit.residuals.shape) * segments.observed
    return segments, replace(misfit, residuals=residuals)


def scales_of(segments: Segments) -> Scales:
    return Scales(np.full(len(segments.sensors.kind), 0.1), np.ones(segments.system.dimension), np.ones(0))


def column(segments: Segments, cycles: float) -> Floats:
    """(M, C, K) a sine with so many cycles a sample in each record and channel, of another phase in each channel."""
    M, C, _ = segments.samples.shape
    times = np.concatenate([np.arange(M * count) for count in COUNTS])
    sine = np.sin(2.0 * np.pi * cycles * times[:, None] + np.arange(C))
    return sine.reshape(-1, M, C).transpose(1, 2, 0)


def test_sums_of_constants_and_lines_are_exact(problem: tuple[Segments, Misfit]) -> None:
    """An identity of the interpolation, near ends as well."""
    segments, misfit = problem
    ones = np.ones(segments.samples.shape)
    half, _ = present(halved(segments, misfit, scales_of(segments), Gaussian(), ones))
    counts = present(half.counts)
    assert (half.steps, half.refine, half.tangent_refine) == (segments.steps, 2, 2)
    assert counts.sum() == pytest.approx(segments.observed.sum(), rel=1e-12)
    line = np.broadcast_to(np.arange(6.0)[:, None, None] + 6.0 * np.arange(41), ones.shape)
    assert np.sum(counts * line[::2]) == pytest.approx(np.sum(segments.observed * line), rel=1e-12)


@pytest.mark.parametrize("loss", [Gaussian(), Student(4.0)], ids=["normal", "robust"])
@pytest.mark.parametrize("cycles", [0.01, 0.05, 0.1])
def test_products_with_smooth_columns_are_those_of_all_samples(
    problem: tuple[Segments, Misfit], cycles: float, loss: Gaussian | Student
) -> None:
    """To 2 % of the standard deviation of a product with noise, up to 0.4 of the Nyquist frequency of the even samples."""
    segments, misfit = problem
    smooth = column(segments, cycles)
    half, fewer = present(halved(segments, misfit, scales_of(segments), loss, smooth))
    weight, counts = loss.weight(misfit.residuals) * segments.observed, present(half.counts)
    power = np.sum(weight * smooth**2, axis=(0, 2))
    product = np.sum(weight * misfit.residuals * smooth, axis=(0, 2))
    of_half = np.sum(counts * fewer.residuals * smooth[::2], axis=(0, 2))
    assert np.max(np.abs(of_half - product) / np.sqrt(power)) < 0.02
    assert np.sum(counts * smooth[::2] ** 2, axis=(0, 2)) == pytest.approx(power, rel=0.01)
    moved = (half.samples - segments.samples[::2]) / 0.1 / present(segments.relative_noise)
    assert np.allclose(moved, fewer.residuals - misfit.residuals[::2], atol=1e-12)  # the same motion


def test_what_is_not_smooth_keeps_all_samples(problem: tuple[Segments, Misfit]) -> None:
    segments, misfit = problem
    scales, smooth = scales_of(segments), column(segments, 0.05)

    def of(segments: Segments, rough: Floats = smooth) -> object:
        return halved(segments, misfit, scales, Gaussian(), rough)

    assert of(segments) is not None
    assert of(segments, column(segments, 0.3)) is None
    spike = smooth.copy()
    spike[3, 0, 10] += 5.0
    assert of(segments, spike) is None
    gap = segments.observed.copy()
    gap[2:5, 1, 10] = False
    assert of(replace(segments, observed=gap)) is None
    single = segments.observed.copy()
    single[3, 1, 10] = False
    assert of(replace(segments, observed=single)) is not None
    sensors = replace(segments.sensors, kind=np.where(segments.sensors.mass == 1, A, segments.sensors.kind))
    assert of(replace(segments, sensors=sensors)) is None
    linked = segments.linked.copy()
    linked[[2, 4]] = False  # two segments are too short for an interpolation
    assert of(replace(segments, linked=linked)) is None
