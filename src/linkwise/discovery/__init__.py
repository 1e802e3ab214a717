"""Discovery of structures: which links and terms a record shows among all candidates (METHODS section 9).

The way from a record to an answer, in the order of the modules: `terms` that a link may have and `candidates`, every term on
every pair of ends; `data_checks` of what the records cannot show; `screen` and `screened_records`, the weak regression that
names a first subset, with a `force_tree` where displacements were not measured; `criterion`, cost and penalty of subsets in a
quadratic model, and its least; `selection`, rounds of fit and change by it, with `term_parameters`; where exact laws leave
more than noise, the other kinds of rounds (`inexact`) and links with `memory`. `discover` calls these in turn. The answer is
judged by what `rivals` explain as well, by `prediction` of pieces left out and by the `evidence` for each term; `judgement`
makes the `result` of it, with a `model_average`.
"""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
