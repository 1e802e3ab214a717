"""Every public function and constructor, each with arguments that it takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse
from problems import chain_record
from reach_rows import reach_maps

import linkwise as lw

CHAIN = lw.bnes_chain(2)
LINK = CHAIN.link("nes1")
NUMBER = lw.Coefficient.number
LAW = "k*d + c*v"
ML = ("offsets", "gains", "delays", "drifts", "ambient", "input_noise", "admit")
BEAM = lw.Host("beam", (lw.HostMode(NUMBER(20.0), NUMBER(0.005), {"tip": 1.0}),))


@dataclass(frozen=True)
class Call:
    """A call that works."""

    function: Callable[..., Any]
    arguments: Mapping[str, Any]

    def __call__(self, **changes: Any) -> Any:
        return self.function(**{**self.arguments, **changes})

    @property
    def names(self) -> list[str]:
        """The parameters that are named, those that the call leaves out included."""
        parameters = inspect.signature(self.function).parameters.values()
        collected = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        named = [parameter.name for parameter in parameters if parameter.kind not in collected]
        return list(dict.fromkeys([*named, *self.arguments]))


def structures() -> dict[str, Call]:
    """Calls that build and read structures."""
    modes = (lw.HostMode(NUMBER(20.0), NUMBER(0.005), {"tip": 1.0}),)
    matrix = scipy.sparse.csc_array(np.diag([1.0, 2.0]))
    return {
        "Structure": Call(lw.Structure, {"name": "s", "masses": CHAIN.masses, "links": CHAIN.links}),
        "Mass": Call(lw.Mass, {"name": "m1", "mass": NUMBER(1.0)}),
        "Link": Call(
            lw.Link,
            {"name": "a", "between": ("m1", "m2"), "law": lw.Law.parse("k*d"), "coefficients": {"k": NUMBER(1.0)}},
        ),
        "Link with memory": Call(
            lw.Link,
            {
                "name": "a", "between": ("m1", "m2"), "law": lw.Law.parse("k*z"), "coefficients": {"k": NUMBER(1.0)},
                "states": {"z": "v - z"},
            },
        ),
        "LinkState": Call(lw.LinkState, {"rate": "v - z"}),
        "Law.parse": Call(lw.Law.parse, {"text": LAW}),
        "Law.force": Call(lw.Law.parse(LAW).force, {"d": 0.1, "v": 0.2, "values": {"k": 1.0, "c": 2.0}}),
        "Law.partials": Call(lw.Law.parse(LAW).partials, {"d": 0.1, "v": 0.2, "values": {"k": 1.0, "c": 2.0}}),
        "Law.potential": Call(lw.Law.parse(LAW).potential, {"d": 0.1, "values": {"k": 1.0, "c": 2.0}}),
        "Coefficient": Call(lw.Coefficient, {"value": 1.0, "known": True}),
        "Coefficient.number": Call(NUMBER, {"value": 1.0}),
        "Coefficient.unknown": Call(lw.Coefficient.unknown, {}),
        "Host": Call(lw.Host, {"name": "beam", "modes": modes}),
        "HostMode": Call(lw.HostMode, {"frequency": NUMBER(20.0), "damping": NUMBER(0.01), "shape": {"tip": 1.0}}),
        "Host.shape": Call(BEAM.shape, {"point": "tip"}),
        "Host.known_to_within": Call(BEAM.known_to_within, {"frequency": 0.1}),
        "Structure.mass": Call(CHAIN.mass, {"name": "m1"}),
        "Structure.link": Call(CHAIN.link, {"name": "nes1"}),
        "Structure.coefficient": Call(CHAIN.coefficient, {"name": "nes1.alpha"}),
        "Structure.unknown": Call(lambda which: CHAIN.unknown(which), {"which": "nes"}),
        "Structure.with_values": Call(CHAIN.with_values, {"values": {"nes1.alpha": -90.0}}),
        "Structure.elongations": Call(CHAIN.elongations, {"x": np.zeros(2)}),
        "Link.force": Call(LINK.force, {"d": 0.1}),
        "Link.stiffness": Call(LINK.stiffness, {"d": 0.1}),
        "Link.potential": Call(LINK.potential, {"d": 0.1}),
        "bnes_chain": Call(lw.bnes_chain, {"n": 2}),
        "named_law": Call(lw.named_law, {"name": "dahl"}),
        "NamedLaw.link": Call(lw.named_law("dahl").link, {"name": "a", "between": ("m1", "m2")}),
        "parse_structure": Call(lw.parse_structure, {"text": lw.format_structure(CHAIN)}),
        "format_structure": Call(lw.format_structure, {"structure": CHAIN}),
        "write_structure": Call(lw.write_structure, {"structure": CHAIN, "path": "written.toml"}),
        "read_structure": Call(lw.read_structure, {"path": "chain.toml"}),
        "read_partial_structure": Call(lw.read_partial_structure, {"path": "chain.toml"}),
        "read_matrix": Call(lw.read_matrix, {"named": "beam.mtx"}),
        "read_host_matrices": Call(lw.read_host_matrices, {"mass": "beam.mtx", "stiffness": "stiff.mtx"}),
        "HostMatrices.reduce": Call(
            lw.HostMatrices(matrix, 100.0 * matrix, None, ("1", "2")).reduce,
            {"name": "beam", "points": {"tip": 1}, "keep": 1},
        ),
        "read_modes": Call(lw.read_modes, {"path": "modes.csv"}),
        "reduce_host": Call(
            lw.reduce_host,
            {"name": "beam", "mass": matrix, "stiffness": 100.0 * matrix, "points": {"tip": 1}, "keep": 1},
        ),
        "to_si": Call(lw.to_si, {"given": "10 g", "dimension": "kg"}),
        "parse_terms": Call(lw.parse_terms, {"text": "v, d"}),
        "Excitation.of": Call(lw.Excitation.of, {"release": {"v:m1": 1.0}}),
        "Impulse": Call(lw.Impulse, {"mass": "m1", "momentum": 1.0}),
        "TimeFunction": Call(lw.TimeFunction, {"text": "sin(t)"}),
        "Sampled": Call(lw.Sampled, {"start": 0.0, "rate": 100.0, "values": np.sin(np.arange(50.0))}),
        "wells": Call(lw.wells, {"link": LINK}),
        "barrier": Call(lw.barrier, {"link": LINK}),
        "modes": Call(lw.modes, {"structure": CHAIN}),
        "equilibria": Call(lw.equilibria, {"structure": CHAIN}),
        "align_truth": Call(lw.align_truth, {"discovered": CHAIN, "truth": CHAIN}),
        "term_score": Call(lw.term_score, {"discovered": CHAIN, "truth": CHAIN}),
    }  # fmt: skip


def compared_at(size: float) -> lw.Record:
    """A tap of a beam."""
    beam = lw.Structure("beam", (), (), (BEAM,))
    forces = {"beam.tip": f"{size}*exp(-((t - 0.1)/0.01)**2)"}
    return lw.simulate(beam, forces=forces, duration=1.0, rate=160.0).with_noise(40.0, seed=1)


def records(record: lw.Record) -> dict[str, Call]:
    """Calls that build and read records."""
    time, release = record.time, {"v:m1": 1.0}
    waves = {f"x:m{number}": np.sin(20.0 * np.pi * number * time) for number in (1, 2)}
    periodic = lw.Record.from_arrays(time, waves)
    clean = lw.simulate(CHAIN, duration=0.5, rate=500.0, release=release, sensors=("x", "v", "a"))
    tapped = [compared_at(size) for size in (1.0, 2.0)]
    columns = {"x:m1": record.channel("x:m1"), "x:m2": record.channel("x:m2")}
    later = lw.Record.from_arrays(time + 0.6, {name: 2.0 * values for name, values in columns.items()})
    accelerations = lw.Record.from_arrays(time, {f"a:{name[2:]}": values for name, values in columns.items()})
    return {
        "Record": Call(
            lw.Record, {"start": 0.0, "rate": 500.0, "channels": record.channels, "values": record.values}
        ),
        "Record.from_arrays": Call(lw.Record.from_arrays, {"time": time, "channels": columns}),
        "Record.channel": Call(record.channel, {"name": "x:m1"}),
        "Record.unit": Call(record.unit, {"name": "x:m1"}),
        "Record.select": Call(record.select, {"names": ["x:m1"]}),
        "Record.between": Call(record.between, {"earliest": 0.1, "latest": 0.2}),
        "Record.decimate": Call(record.decimate, {"factor": 2}),
        "Record.with_noise": Call(record.with_noise, {"decibel": 20.0, "seed": 1}),
        "Channel.parse": Call(lw.Channel.parse, {"name": "x:m1"}),
        "SensorUncertainty": Call(lw.SensorUncertainty, {"gain": 0.01}),
        "RecordMapping": Call(lw.RecordMapping, {"channels": {"x:m1": 1}}),
        "SensorStatement.of": Call(lw.SensorStatement.of, {"stated": {"gain": 1.0}, "channel": "x:m1"}),
        "simulate": Call(
            lw.simulate,
            {"structure": CHAIN, "duration": 0.05, "rate": 500.0, "release": release, "impulses": ()},
        ),
        "simulate at times": Call(lw.simulate, {"structure": CHAIN, "times": time[:50], "release": release}),
        "orbit_envelope": Call(
            lw.orbit_envelope, {"structure": CHAIN, "release": release, "duration": 0.05, "rate": 500.0}
        ),
        "average_periods": Call(lw.average_periods, {"record": periodic, "period": 0.1}),
        "beside": Call(lw.beside, {"record": record, "other": accelerations}),
        "continued": Call(lw.continued, {"record": record, "other": later}),
        "joined_by_time": Call(lw.joined_by_time, {"record": record, "other": accelerations}),
        "mark_missing": Call(lw.mark_missing, {"record": record}),
        "without_delays": Call(lw.without_delays, {"record": record, "delays": {"x:m1": 1e-4}}),
        "differentiate": Call(lw.differentiate, {"record": record}),
        "noisy_states": Call(
            lw.noisy_states, {"record": clean, "convention": "displacement", "snr_db": 30.0, "seed": 1}
        ),
        "read_record": Call(lw.read_record, {"path": "record.csv"}),
        "read_mapping": Call(lw.read_mapping, {"path": "mapping.toml"}),
        "write_record": Call(lw.write_record, {"record": record, "path": "written.csv"}),
        "inspect": Call(lw.inspect, {"records": record}),
        "identify_host": Call(lw.identify_host, {"record": tapped[0], "modes": 1}),
        "compare_levels": Call(lw.compare_levels, {"records": tapped, "modes": 1}),
        "ResponseFunction.of": Call(
            lw.ResponseFunction.of,
            {"record": tapped[0], "response": "x:beam.tip", "force": "force:beam.tip"},
        ),
    }


def answers(record: lw.Record, fitted: lw.Estimate, discovered: lw.Discovery) -> dict[str, Call]:
    """Calls that ask for answers and read them."""
    states = lw.differentiate(record)
    equations = lw.monomial_equations(states, 3)
    regression = lw.Stlsq(threshold=1e-3).fit(equations)
    # swapped, the duration and the rate are a simulation that takes a moment
    drive: dict[str, Any] = {"duration": 0.2, "rate": 100.0, "release": {"v:m1": 1.0}}
    absorbed = lw.absorb(CHAIN, **drive)
    clean = chain_record(2, duration=0.5, rate=500.0)
    short = clean.between(0.0, 0.1)
    moving = clean.between(0.0, 0.2)
    validated = lw.validate(moving, CHAIN)
    return {
        "identify": Call(
            lw.identify, {"record": record, "structure": CHAIN.unknown("nes"), "method": "weak"}
        ),
        "identify by likelihood": Call(
            lw.identify,
            {"record": short, "structure": CHAIN.unknown("nes1.c"), "exact": True, **dict.fromkeys(ML, ())},
        ),
        "MaximumLikelihood": Call(lw.MaximumLikelihood, {}),
        "PhysicsInformedSindy": Call(lw.PhysicsInformedSindy, {}),
        "Stlsq": Call(lw.Stlsq, {}),
        "L1": Call(lw.L1, {}),
        "Huber": Call(lw.Huber, {}),
        "Student": Call(lw.Student, {}),
        "nmse": Call(lw.nmse, {"true": LINK, "estimated": LINK, "record": record}),
        "law_path": Call(
            lw.law_path,
            {"record": record, "structure": CHAIN, "link": "nes1", "most": 0, "candidates": ("v", "d")},
        ),
        "limit": Call(
            lw.limit,
            {
                "structure": CHAIN,
                "noise": 1e-4,
                "unknown": ["nes"],
                "duration": 0.05,
                "rate": 500.0,
                "release": {"v:m1": 1.0},
            },
        ),
        "free_run": Call(lw.free_run, {"structure": CHAIN, "record": record}),
        "validate": Call(lw.validate, {"record": moving, "answer": CHAIN}),
        "check_discovery": Call(lw.check_discovery, {"record": record, "masses": {"m1": 1.0, "m2": 0.01}}),
        "DiscoveryOptions": Call(lw.DiscoveryOptions, {}),
        "Discovery.force_band": Call(discovered.force_band, {"link": "m2-m1", "d": [0.0, 0.01]}),
        "Discovery.decision": Call(discovered.decision, {"link": "m2-m1"}),
        "Estimate.coefficient": Call(fitted.coefficient, {"name": "nes1.alpha"}),
        "Estimate.link": Call(fitted.link, {"name": "nes1"}),
        "Estimate.force_band": Call(fitted.force_band, {"name": "nes1", "d": [0.0, 0.01]}),
        "LinkEstimate.force_band": Call(fitted.link("nes1").force_band, {"d": [0.0, 0.01]}),
        "equivalent": Call(
            lw.equivalent, {"link": fitted.link("nes1"), "amplitude": 0.01, "frequency": 10.0}
        ),
        "Posterior.of": Call(lw.Posterior.of, {"estimate": fitted}),
        "profile_interval": Call(lw.profile_interval, {"estimate": fitted, "name": "nes1.alpha"}),
        "result_of": Call(lw.result_of, {"estimate": fitted}),
        "discovery_of": Call(lw.discovery_of, {"discovery": discovered}),
        "absorb": Call(
            lw.absorb, {"structure": CHAIN, **drive, "sinks": (), "without": "removed", "settle": 0.1}
        ),
        "absorb with options": Call(
            lw.absorb, {"structure": CHAIN, "options": lw.AbsorptionOptions.of(**drive)}
        ),
        "AbsorptionOptions": Call(lw.AbsorptionOptions, {"duration": 1.0}),
        "absorption_intervals": Call(
            lw.absorption_intervals, {"identified": fitted, "draws": 2, "workers": 1, **drive}
        ),
        "absorption_map": Call(
            lw.absorption_map, {"structure": CHAIN, "over": {"nes1.alpha": [-100.0]}, "workers": 1, **drive}
        ),
        "absorption_of": Call(lw.absorption_of, {"result": absorbed}),
        "validation_of": Call(lw.validation_of, {"validation": validated}),
        "link_columns": Call(lw.link_columns, {"states": states, "structure": CHAIN.unknown("nes")}),
        "local_equations": Call(lw.local_equations, {"states": states, "structure": CHAIN, "order": 1}),
        "monomial_equations": Call(lw.monomial_equations, {"states": states, "order": 1}),
        "monomial_force": Call(
            lw.monomial_force, {"fit": regression, "structure": CHAIN, "link": "nes1", "record": clean}
        ),
        "monomial_nmse": Call(
            lw.monomial_nmse, {"fit": regression, "structure": CHAIN, "link": "nes1", "record": clean}
        ),
        "export_answer": Call(lw.export_answer, {"answer": CHAIN, "path": "answer.mat"}),
        **{
            name: Call(getattr(lw, name), {first: result, "folder": f"written {name}"})
            for name, first, result in (
                ("write_result", "estimate", fitted),
                ("write_discovery", "discovery", discovered),
                ("write_absorption", "result", absorbed),
                ("write_validation", "validation", validated),
                ("write_inspection", "inspection", lw.inspect(record)),
            )
        },
    }


def figures(record: lw.Record, fitted: lw.Estimate, discovered: lw.Discovery) -> dict[str, Call]:
    """Calls that draw."""
    drive: dict[str, Any] = {"duration": 0.05, "rate": 500.0, "release": {"v:m1": 1.0}}
    absorbed, validated = lw.absorb(CHAIN, **drive), lw.validate(record, CHAIN)
    swept = lw.absorption_map(CHAIN, {"nes1.alpha": [-150.0, -100.0]}, workers=1, **drive)
    envelope = lw.orbit_envelope(CHAIN, {"v:m1": 1.0}, duration=0.05, rate=500.0)
    compared = {
        "true": LINK,
        "identified": {"weak": lw.bnes_chain(2, beta=1.1e6).link("nes1")},
        "d_range": (-0.02, 0.02),
    }
    rows = [lw.Row("bnes-2", 2, 20.0, "ml", 1, "converged", {"nes1": 0.1}, seconds=1.0)]
    arguments: dict[str, dict[str, Any]] = {
        "force": {"estimate": fitted, "link": "nes1"},
        "loop": {"estimate": fitted, "link": "nes1"},
        "surface": {"estimate": fitted, "link": "nes1"},
        "histories": {"record": record},
        "histories_figure": {"record": record},
        "spectrum": {"record": record, "name": "x:m1"},
        "spectra_figure": {"inspection": lw.inspect(record)},
        "spectrogram": {"record": record, "name": "x:m1"},
        "coherence": {"record": record, "first": "x:m1", "second": "x:m2"},
        "spectrograms_figure": {"inspection": lw.inspect(record)},
        "coherences_figure": {"inspection": lw.inspect(record)},
        "residuals": {"estimate": discovered.estimate, "channel": "x:m1"},
        "residuals_figure": {"estimate": discovered.estimate},
        "graph": {"discovery": discovered},
        "path": {"discovery": discovered},
        "runners_up": {"discovery": discovered},
        "evidence": {"discovery": discovered},
        "departures": {"discovery": discovered, "link": "m2-m1"},
        "prediction": {"validation": validated, "channel": "x:m1"},
        "prediction_error": {"validation": validated, "channel": "x:m1"},
        "prediction_spectrum": {"validation": validated, "channel": "x:m1"},
        "prediction_profile": {"validation": validated, "quantity": "d of nes1"},
        "absorption": {"result": absorbed},
        "energy": {"result": absorbed},
        "crossings": {"result": absorbed},
        "map": {"result": swept, "quantity": "sinks_share"},
        "map_figure": {"result": swept, "names": ["sinks_share"]},
        "displacement": {"envelope": envelope, "mass": "m1"},
        "displacements_figure": {"envelope": envelope},
        "force_comparison": compared,
        "force_errors": compared,
        "force_comparison_figure": compared,
        "shapes": {"host": BEAM},
        "shapes_figure": {"structure": lw.Structure("beam", (), (), (BEAM,))},
        "study": {"result": rows},
        "accuracy_figure": {"result": rows},
        "success_map": {"result": reach_maps()[0]},
        "success_figure": {"results": reach_maps()},
    }
    return {f"plot.{name}": Call(getattr(lw.plot, name), given) for name, given in arguments.items()}
