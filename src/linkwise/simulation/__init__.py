"""From a structure under an excitation to a record."""
