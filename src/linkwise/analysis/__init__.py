"""What follows from a structure alone: wells, equilibria, modes, kinds of laws."""
