"""Channels that were recorded late, taken at the time at which they were measured."""
