"""What sinks do for a structure: how it goes on without them, where energy goes, how often they cross wells."""

from linkwise.absorption import text as text
