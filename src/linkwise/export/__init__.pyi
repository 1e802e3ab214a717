"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.export.answer import export_answer as export_answer
from linkwise.export.equations import export_equations as export_equations

__all__: list[str]
