"""Gains of drives: joint torque per ampere, with what they rest on."""
