"""Elasticity of gears, from encoders on both of their sides."""
