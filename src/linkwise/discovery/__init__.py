"""Discovery of structures: which links and terms a record shows among all candidates (METHODS section 9)."""

from linkwise.discovery import text as text
