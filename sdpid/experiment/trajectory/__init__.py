"""Trajectories: Fourier series and the excitation of the paper."""
