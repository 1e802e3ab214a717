"""The precision that a planned test allows, before anybody measures."""

from linkwise.identification.limit import text as text
