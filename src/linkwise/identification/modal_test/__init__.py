"""Modes of a linear structure from the records of a modal test."""

from linkwise.identification.modal_test import text as text
