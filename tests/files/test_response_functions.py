"""Frequency response functions as data: of a modal test, from arrays and from universal files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff

import linkwise as lw

HZ = np.arange(8, 321) * 0.125
MODES = ((5.2, 0.01, {"tip": 1.0, "mid": 0.6}), (21.0, 0.008, {"tip": -0.9, "mid": 0.5}))


def accelerances(noise: float = 0.01) -> dict[str, np.ndarray]:
    """Of both points, by the force at the tip."""
    rng, s = np.random.default_rng(1), 2j * np.pi * HZ
    found = {point: noise * (rng.standard_normal((2, len(HZ))).T @ [1.0, 1j]) for point in ("tip", "mid")}
    for hz, ratio, shape in MODES:
        mode = s**2 / (s**2 + 4.0 * np.pi * ratio * hz * s + (2.0 * np.pi * hz) ** 2)
        found = {point: given + shape[point] * shape["tip"] * mode for point, given in found.items()}
    return found


def assert_modes(record: lw.Record) -> None:
    found = lw.modal.identify_host(record, modes=2)
    for mode, (hz, ratio, shape) in zip(found.host.modes, MODES, strict=True):
        assert mode.frequency.value == pytest.approx(hz, rel=1e-3)  # a tenth of the bandwidth
        assert mode.damping.value == pytest.approx(ratio, rel=0.05)  # of noise of 1 to 2 % at resonance
        for point, size in shape.items():
            assert abs(mode.shape[point]) == pytest.approx(abs(size), rel=0.05)


def test_modes_are_found_from_response_functions() -> None:
    channels = {f"a:wing.{point}": values for point, values in accelerances().items()}
    assert_modes(lw.files.record_of_responses(HZ, channels, force="force:wing.tip"))


def write(path: Path, place: str, values: np.ndarray, **stated: Any) -> None:
    """Add one accelerance to a universal file."""
    data = pyuff.prepare_58(
        func_type=4, rsp_ent_name=place, rsp_dir=3, ref_ent_name="wing.tip", ref_dir=3, data=values, x=HZ,
        abscissa_spacing=1, abscissa_spec_data_type=18, ordinate_spec_data_type=12, orddenom_spec_data_type=13,
        num_pts=len(HZ), abscissa_min=HZ[0], abscissa_inc=0.125, binary=0, id1="NONE", rsp_node=12, ref_node=12,
    ) | stated  # fmt: skip
    pyuff.UFF(str(path)).write_sets(data, "add")


def test_a_universal_file_of_response_functions_is_a_record(tmp_path: Path) -> None:
    for point, values in accelerances().items():
        write(tmp_path / "wing.uff", f"wing.{point}", values)
    record = lw.read_record(tmp_path / "wing.uff")
    assert set(record.channels) == {"force:wing.tip", "a:wing.tip", "a:wing.mid"}
    assert_modes(record)


def test_nodes_are_named_with_their_directions(tmp_path: Path) -> None:
    values = accelerances(0.0)["tip"]
    for direction in (3, -1):
        write(tmp_path / "wing.uff", "NONE", values, ref_ent_name="NONE", rsp_dir=direction)
    record = lw.read_record(tmp_path / "wing.uff")
    assert record.channels == ("force:12z", "a:12z", "a:12x")
    np.testing.assert_allclose(record.channel("a:12x"), -record.channel("a:12z"), atol=1e-9)  # as printed
    write(tmp_path / "wing.uff", "wing.mid", values, ref_ent_name="wing.mid")
    with pytest.raises(lw.RecordError, match=r"of forces at 12z, wing\.mid; keep those of one in a file"):
        lw.read_record(tmp_path / "wing.uff")


UNITS = [("g", "NONE", 9.80665), ("g/kN", "NONE", 9.80665e-3), ("m/s^2", "lbf", 1.0 / 4.4482216152605)]


@pytest.mark.parametrize(("response", "force", "size"), UNITS)
def test_units_of_response_functions_count(tmp_path: Path, response: str, force: str, size: float) -> None:
    path, tip = tmp_path / "wing.uff", accelerances(0.0)["tip"]
    write(path, "wing.tip", tip, ordinate_axis_units_lab=response, orddenom_axis_units_lab=force)
    in_si = lw.files.record_of_responses(HZ, {"a:wing.tip": tip}, force="force:wing.tip")
    a, f = (
        [np.ptp(one.channel(name)) for one in (lw.read_record(path), in_si)] for name in in_si.channels[::-1]
    )
    assert a[0] / f[0] == pytest.approx(size * a[1] / f[1], rel=1e-6)  # as printed


def test_lines_and_motions_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    tip = {"a:tip": accelerances()["tip"]}
    with pytest.raises(lw.RecordError, match="evenly spaced multiples"):
        lw.files.record_of_responses([], {"a:tip": []}, force="force:tip")
    with pytest.raises(lw.RecordError, match="evenly spaced multiples"):
        lw.files.record_of_responses(HZ**1.01, tip, force="force:tip")
    with pytest.raises(lw.RecordError, match="has 313 lines, and there are 312 frequencies"):
        lw.files.record_of_responses(HZ[1:], tip, force="force:tip")
    for kind, reason in (
        (1, "which motion the response function of tip"),
        (12, "two response functions of a:tip"),
    ):
        for _ in range(2):
            write(tmp_path / f"{kind}.uff", "tip", tip["a:tip"], ordinate_spec_data_type=kind)
        with pytest.raises(lw.RecordError, match=reason):
            lw.read_record(tmp_path / f"{kind}.uff")
