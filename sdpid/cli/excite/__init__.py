"""The command ``sdpid excite``."""
