"""Output error: parameters whose simulated motion is the measured one."""
