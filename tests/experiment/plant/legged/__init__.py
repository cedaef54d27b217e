"""Tests of robots on legs."""
