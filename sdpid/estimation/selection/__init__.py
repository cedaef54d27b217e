"""The choice of effects by the data."""
