"""Prediction of records: free runs, restarted windows, one step ahead, and what disagrees."""
