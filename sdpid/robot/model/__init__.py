"""The robot model: kinematics, regressor, base parameters, geometry."""
