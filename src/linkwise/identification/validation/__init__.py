"""Prediction of records: free runs, restarted windows, one step ahead, and what disagrees."""

from linkwise.identification.validation import text as text
