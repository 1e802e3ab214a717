"""Noise of sampled signals, smoothing, integration and differentiation."""
