"""Instrumental variables: estimates that noise in the measured motion does not bias."""
