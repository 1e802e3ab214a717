"""Figures of results. Each function draws on the Axes that it is given, or on those of a new figure, and returns them.

`force`, `force_comparison`, `force_errors`, `loop`, `surface`, `histories`, `displacement`, `spectrum`, `graph`, `path`,
`runners_up`, `evidence`, `departures`, `prediction`, `prediction_error`, `prediction_profile`, `prediction_spectrum`,
`absorption`, `energy`, `crossings`, `map`, `level_modes`, `level_response`, `distortion`, `ring_down` and `study` draw one
picture on one Axes. Functions whose names end in `_figure` put these pictures together as the commands write them. All take
results and compute nothing. Names load on first use, so that matplotlib is imported when something is drawn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkwise.lazy import lazy_names

if TYPE_CHECKING:
    from linkwise.plot.absorption_crossings import crossings, crossings_figure
    from linkwise.plot.absorption_decay import absorption, decay_figure
    from linkwise.plot.absorption_energy import energy, energy_figure
    from linkwise.plot.absorption_map import map, map_figure
    from linkwise.plot.channel_spectra import spectra_figure, spectrum
    from linkwise.plot.discovery_average import departures, departures_figure
    from linkwise.plot.discovery_evidence import evidence, evidence_figure
    from linkwise.plot.discovery_graph import graph, graph_figure
    from linkwise.plot.discovery_path import path, path_figure, runners_up
    from linkwise.plot.displacements import displacement, displacements_figure
    from linkwise.plot.force_comparisons import force_comparison, force_comparison_figure, force_errors
    from linkwise.plot.level_distortion import distortion, distortion_figure
    from linkwise.plot.level_frequencies import level_modes, levels_figure
    from linkwise.plot.level_responses import level_response, level_responses_figure
    from linkwise.plot.level_ring_downs import ring_down, ring_down_figure
    from linkwise.plot.link_force import force, force_figure
    from linkwise.plot.link_loop import loop, loop_figure
    from linkwise.plot.link_surface import surface, surface_figure
    from linkwise.plot.study_accuracy import accuracy_figure, study
    from linkwise.plot.style import save
    from linkwise.plot.time_histories import histories, histories_figure
    from linkwise.plot.validation_prediction import (
        prediction,
        prediction_error,
        prediction_error_figure,
        prediction_figure,
    )
    from linkwise.plot.validation_profiles import (
        prediction_profile,
        prediction_profile_figure,
        prediction_spectrum,
        prediction_spectrum_figure,
    )

__all__ = [
    "absorption",
    "accuracy_figure",
    "crossings",
    "crossings_figure",
    "decay_figure",
    "departures",
    "departures_figure",
    "displacement",
    "displacements_figure",
    "distortion",
    "distortion_figure",
    "energy",
    "energy_figure",
    "evidence",
    "evidence_figure",
    "force",
    "force_comparison",
    "force_comparison_figure",
    "force_errors",
    "force_figure",
    "graph",
    "graph_figure",
    "histories",
    "histories_figure",
    "level_modes",
    "level_response",
    "level_responses_figure",
    "levels_figure",
    "loop",
    "loop_figure",
    "map",
    "map_figure",
    "path",
    "path_figure",
    "prediction",
    "prediction_error",
    "prediction_error_figure",
    "prediction_figure",
    "prediction_profile",
    "prediction_profile_figure",
    "prediction_spectrum",
    "prediction_spectrum_figure",
    "ring_down",
    "ring_down_figure",
    "runners_up",
    "save",
    "spectra_figure",
    "spectrum",
    "study",
    "surface",
    "surface_figure",
]

# The module that each name lives in; a test keeps it equal to the imports that only type checkers see.
_HOMES = {
    "absorption_crossings": ("crossings", "crossings_figure"),
    "absorption_decay": ("absorption", "decay_figure"),
    "absorption_energy": ("energy", "energy_figure"),
    "absorption_map": ("map", "map_figure"),
    "channel_spectra": ("spectra_figure", "spectrum"),
    "discovery_average": ("departures", "departures_figure"),
    "discovery_evidence": ("evidence", "evidence_figure"),
    "discovery_graph": ("graph", "graph_figure"),
    "discovery_path": ("path", "path_figure", "runners_up"),
    "displacements": ("displacement", "displacements_figure"),
    "force_comparisons": ("force_comparison", "force_comparison_figure", "force_errors"),
    "level_distortion": ("distortion", "distortion_figure"),
    "level_frequencies": ("level_modes", "levels_figure"),
    "level_responses": ("level_response", "level_responses_figure"),
    "level_ring_downs": ("ring_down", "ring_down_figure"),
    "link_force": ("force", "force_figure"),
    "link_loop": ("loop", "loop_figure"),
    "link_surface": ("surface", "surface_figure"),
    "study_accuracy": ("accuracy_figure", "study"),
    "style": ("save",),
    "time_histories": ("histories", "histories_figure"),
    "validation_prediction": (
        "prediction",
        "prediction_error",
        "prediction_error_figure",
        "prediction_figure",
    ),
    "validation_profiles": (
        "prediction_profile",
        "prediction_profile_figure",
        "prediction_spectrum",
        "prediction_spectrum_figure",
    ),
}

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
