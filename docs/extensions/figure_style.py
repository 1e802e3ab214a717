"""The look of the gallery's figures; the examples themselves draw in plain matplotlib."""

from __future__ import annotations

import matplotlib as mpl


def reset(gallery_conf: object, name: str) -> None:
    """Draw the figures of all examples alike, whatever the example before has set."""
    mpl.rcParams.update(
        {
            "axes.grid": True,
            "axes.prop_cycle": mpl.cycler(
                color=["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"]
            ),
            "axes.spines.right": False,
            "axes.spines.top": False,
            "axes.titlelocation": "left",
            "axes.titlesize": 10,
            "figure.constrained_layout.use": True,
            "figure.figsize": (6.6, 3.2),
            "font.size": 9,
            "grid.alpha": 0.35,
            "grid.linewidth": 0.5,
            "legend.fontsize": 8,
            "legend.frameon": False,
            "lines.linewidth": 1.2,
            "savefig.dpi": 160,
        }
    )
