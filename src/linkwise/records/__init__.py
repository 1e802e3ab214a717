"""What was measured or simulated: channels on one time axis."""
